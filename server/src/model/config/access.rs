//! `[[access]]`, and the keys of `[server]` that say who may connect.

use std::net::IpAddr;

use time::{Date, Month, Time, UtcOffset};
use toml::de::DeValue;

use super::reader::{Table, found};
use crate::model::access::{AccessConfig, AccessEntry, Identity, ROLES, Role, TokenHash};

const ACCESS_KEYS: [&str; 8] =
    ["name", "role", "cameras", "token", "password", "certificate", "forwarded", "expires"];
const MAX_NAME_LEN: usize = 80;
const NEEDS_PROOF: &str = "`roundel token add NAME --role ROLE --config FILE` writes the entry and prints a new token; \
     `certificate` is the common name of a client certificate";

/// `cameras` has the names of all cameras, or is `None` where they are not read.
pub(super) fn access(
    root: &Table<'_, '_>,
    server: &Table<'_, '_>,
    cameras: Option<&[&str]>,
) -> AccessConfig {
    let mut entries: Vec<AccessEntry> = Vec::new();
    for table in root.tables("access", "[[access]]", &ACCESS_KEYS) {
        let Some(entry) = entry(&table, cameras) else { continue };
        let name = &entry.identity.name;
        if entries.iter().any(|other| other.identity.name == *name) {
            table.fail("name", format!("two entries of [[access]] are named \"{name}\""), "");
        }
        entries.push(entry);
    }
    AccessConfig {
        entries,
        allow_hosts: hosts(server),
        trusted_proxies: addresses(server),
        insecure: server.flag("insecure").unwrap_or(false),
    }
}

fn entry(table: &Table<'_, '_>, cameras: Option<&[&str]>) -> Option<AccessEntry> {
    let name = table.required_text("name", "\"alice\"");
    table.require("role", "\"view\"");
    let role = table.choice("role", &ROLES);
    let fed = role.and_then(|role| fed_cameras(table, role, cameras));
    let token = table.text("token").and_then(|text| token_hash(table, text));
    let password = table.text("password").and_then(|text| password_hash(table, text));
    let certificate = table.text("certificate").map(str::to_owned);
    let forwarded = table.text("forwarded").map(str::to_owned);
    let expires_s = expires_s(table);
    if !["token", "password", "certificate", "forwarded"].iter().any(|key| table.has(key)) {
        let message =
            "an entry of [[access]] needs a `token`, `password`, `certificate` or `forwarded`";
        table.fail("name", message, NEEDS_PROOF);
    }
    let name = name?;
    if name.chars().count() > MAX_NAME_LEN || name.chars().any(char::is_control) {
        let message = format!("`name` must have at most {MAX_NAME_LEN} printable characters");
        return table.reject("name", message, "");
    }
    let identity = Identity { name: name.to_owned(), role: role?, cameras: fed };
    Some(AccessEntry { identity, token, password, certificate, forwarded, expires_s })
}

/// The cameras of a feeding identity; `None`: all.
fn fed_cameras(table: &Table<'_, '_>, role: Role, known: Option<&[&str]>) -> Option<Vec<String>> {
    const KEY: &str = "cameras";
    if role != Role::Feed {
        if table.has(KEY) {
            let help = "identities with the other roles do not push frames of single cameras";
            table.fail(KEY, "`cameras` is only for `role = \"feed\"`", help);
        }
        return None;
    }
    table.require(KEY, "[\"north\"], or [\"*\"] for all");
    let names = table.texts(KEY, "a list of names of cameras, or [\"*\"] for all")?;
    if names.iter().any(|name| name == "*") {
        return None;
    }
    for name in &names {
        if known.is_some_and(|known| !known.contains(&name.as_str())) {
            let message = format!("no camera is named \"{name}\"");
            table.fail(KEY, message, "names of cameras are those of the [[camera]] tables");
        }
    }
    Some(names)
}

fn token_hash(table: &Table<'_, '_>, text: &str) -> Option<TokenHash> {
    let hash = text.parse().ok();
    // The text may be the token itself, which must not be printed.
    hash.or_else(|| {
        table.reject("token", "`token` must be \"sha256:\" and 64 hexadecimal digits", NEEDS_PROOF)
    })
}

fn password_hash(table: &Table<'_, '_>, text: &str) -> Option<String> {
    if argon2::PasswordHash::new(text).is_ok_and(|hash| hash.algorithm.as_str() == "argon2id") {
        return Some(text.to_owned());
    }
    let help = "`roundel token add NAME --role ROLE --password --config FILE` asks for a password and writes its hash";
    table.reject(
        "password",
        "`password` must be an argon2id hash, which begins with \"$argon2id$\"",
        help,
    )
}

/// A date (midnight) or a date with time, in UTC unless it has an offset.
fn expires_s(table: &Table<'_, '_>) -> Option<i64> {
    const KEY: &str = "expires";
    const HELP: &str = "write a date such as 2027-12-31, or 2027-12-31T18:00:00Z; without quotes";
    let value = table.value(KEY)?.get_ref();
    let unix_s = |datetime: &toml::value::Datetime| {
        let date = datetime.date?;
        let month = Month::try_from(date.month).ok()?;
        let date = Date::from_calendar_date(i32::from(date.year), month, date.day).ok()?;
        let time = match datetime.time {
            None => Time::MIDNIGHT,
            Some(time) => Time::from_hms(time.hour, time.minute, time.second.unwrap_or(0)).ok()?,
        };
        let minutes = match datetime.offset {
            Some(toml::value::Offset::Custom { minutes }) => minutes,
            _ => 0,
        };
        let offset = UtcOffset::from_whole_seconds(i32::from(minutes) * 60).ok()?;
        Some(date.with_time(time).assume_offset(offset).unix_timestamp())
    };
    let known = if let DeValue::Datetime(datetime) = value { unix_s(datetime) } else { None };
    let message = || format!("`expires` must be a date, found {}", found(value));
    known.or_else(|| table.reject(KEY, message(), HELP))
}

/// `allow_hosts`: names in lower case, without port.
fn hosts(server: &Table<'_, '_>) -> Vec<String> {
    const KEY: &str = "allow_hosts";
    let names = server.texts(KEY, "a list of host names").unwrap_or_default();
    for name in &names {
        let is_host = !name.is_empty()
            && name.chars().all(|c| c.is_ascii_alphanumeric() || "-._*".contains(c));
        if !is_host {
            let message = format!("`allow_hosts` must be a list of host names, found \"{name}\"");
            server.fail(KEY, message, "write \"roundel.lab.example.org\", without scheme and port");
        }
    }
    names.into_iter().map(|name| name.to_ascii_lowercase()).collect()
}

/// `trusted_proxies`: IP addresses.
fn addresses(server: &Table<'_, '_>) -> Vec<IpAddr> {
    const KEY: &str = "trusted_proxies";
    let mut addresses = Vec::new();
    for text in server.texts(KEY, "a list of IP addresses").unwrap_or_default() {
        match text.parse() {
            Ok(address) => addresses.push(address),
            Err(_) => {
                let message = format!("`trusted_proxies` must be IP addresses, found \"{text}\"");
                server.fail(KEY, message, "write \"10.0.0.2\"");
            }
        }
    }
    addresses
}
