//! `[server] source_folders` and `source_networks`: what sources that clients name may reach.

use std::{net::IpAddr, ops::Range, path::Path, sync::Arc};

use ipnet::IpNet;
use toml::de::DeValue;

use super::reader::{Table, found};
use crate::model::source_rules::{DEFAULT_NETWORKS, SourceRules};

const FOLDERS_HELP: &str = "write folders such as [\"frames\", \"/data/cameras\"]";
const NETWORKS_HELP: &str = "a network is an address with the number of its leading bits, such as \"192.168.1.0/24\"; \"0.0.0.0/0\" and \"::/0\" \
     are all";

/// `folder`: where relative paths begin; if it is not known, requests may name no file beside the configuration.
pub(super) fn source_rules(table: &Table<'_, '_>, folder: &Path) -> Arc<SourceRules> {
    let own = Some(folder.to_owned()).filter(|folder| !folder.as_os_str().is_empty());
    let folders = texts(table, "source_folders", FOLDERS_HELP).unwrap_or_default();
    let folders = own.into_iter().chain(folders.iter().map(|(name, _)| folder.join(name)));
    let networks = match texts(table, "source_networks", NETWORKS_HELP) {
        Some(networks) => networks
            .iter()
            .filter_map(|(text, span)| {
                network(text).or_else(|| {
                    let message =
                        format!("`source_networks` must be a list of networks, found \"{text}\"");
                    table.fail_at(span, message, NETWORKS_HELP);
                    None
                })
            })
            .collect(),
        None => DEFAULT_NETWORKS.iter().filter_map(|text| network(text)).collect(),
    };
    Arc::new(SourceRules { folders: folders.collect(), networks })
}

/// A network, or a single address.
fn network(text: &str) -> Option<IpNet> {
    text.parse().ok().or_else(|| text.parse::<IpAddr>().ok().map(IpNet::from))
}

/// The texts of a list with their locations; `None` if absent.
fn texts<'t>(
    table: &Table<'t, '_>,
    key: &'static str,
    help: &str,
) -> Option<Vec<(&'t str, Range<usize>)>> {
    let value = table.value(key)?;
    let message = |value: &DeValue<'_>| {
        format!("`{key}` must be a list of texts in quotes, found {}", found(value))
    };
    let Some(items) = value.get_ref().as_array() else {
        table.fail(key, message(value.get_ref()), help);
        return Some(Vec::new());
    };
    let mut texts = Vec::new();
    for item in items.iter() {
        match item.get_ref() {
            DeValue::String(text) if !text.trim().is_empty() => {
                texts.push((text.as_ref(), item.span()));
            }
            other => table.fail_at(&item.span(), message(other), help),
        }
    }
    Some(texts)
}
