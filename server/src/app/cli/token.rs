//! `roundel token`: adds and removes entries of `[[access]]` in a configuration file.

use std::{
    fs,
    io::{self, BufRead as _, IsTerminal},
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::{Context, bail};
use argon2::{Argon2, PasswordHasher};
use clap::{Args, Subcommand};

use super::{print, words};
use crate::model::{
    access::{Role, TokenHash, new_token},
    config::{
        Config, ConfigError, ConfigFile,
        edit::access::{self, NewEntry},
    },
};

const MIN_PASSWORD_LEN: usize = 8;
const ROLES: [(&str, Role, &str); 4] = [
    ("view", Role::View, "read poses, cameras, pictures, events and history"),
    ("feed", Role::Feed, "push frames of the cameras named by --cameras; for nodes"),
    ("operate", Role::Operate, "view, and record, replay, calibrate and drive simulated robots"),
    ("setup", Role::Setup, "everything, also cameras, objects and the configuration"),
];

/// Add and remove credentials of users, programs and nodes.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  \
    roundel token add alice --role operate --config lab.toml\n  \
    roundel token add node-1 --role feed --cameras north,south --config lab.toml\n\n\
    Restart the server afterwards.")]
pub struct TokenArgs {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Add an entry with a new token, which is printed once: the file has only its hash
    Add(AddArgs),
    /// Remove an entry
    Remove {
        /// Name of the entry
        name: String,
        /// The installation's TOML file
        #[arg(long, value_name = "FILE")]
        config: PathBuf,
    },
}

#[derive(Debug, Args)]
struct AddArgs {
    /// Name of the user, program or node
    name: String,
    /// What it may do
    #[arg(long, value_parser = words(&ROLES))]
    role: Role,
    /// The installation's TOML file
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// With --role feed: its cameras, commas between; * for all
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    cameras: Vec<String>,
    /// Refuse the credentials from this date (UTC), such as 2027-12-31, or 2027-12-31T18:00:00Z
    #[arg(long, value_name = "DATE")]
    expires: Option<toml_edit::Datetime>,
    /// Read a password for the dashboard's sign-in from the standard input, in place of a token
    #[arg(long)]
    password: bool,
}

pub(super) fn run(arguments: &TokenArgs) -> anyhow::Result<ExitCode> {
    match &arguments.action {
        Action::Add(arguments) => add(arguments),
        Action::Remove { name, config } => {
            edit(config, |text| Ok(access::remove(text, name)?))?;
            eprintln!("removed \"{name}\" from {}; restart the server", config.display());
            Ok(ExitCode::SUCCESS)
        }
    }
}

fn add(arguments: &AddArgs) -> anyhow::Result<ExitCode> {
    let AddArgs { name, role, config, cameras, expires, password } = arguments;
    match (*role == Role::Feed, cameras.is_empty()) {
        (true, true) => bail!("--role feed needs --cameras NAMES, or --cameras '*' for all"),
        (false, false) => bail!("--cameras is only for --role feed"),
        _ => {}
    }
    let token = new_token();
    let proof = match password {
        false => ("token", TokenHash::of(&token).to_string()),
        true => ("password", password_hash(&read_password()?)?),
    };
    let entry = NewEntry { name, role: *role, cameras, proof, expires: *expires };
    edit(config, |text| Ok(access::add(text, entry)?))?;
    eprintln!("added \"{name}\" to {}; restart the server", config.display());
    if !password {
        eprintln!("the token, which is not stored anywhere and cannot be shown again:");
        print(&format!("{token}\n"))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Changes the file's text if the result is a valid configuration.
fn edit(path: &Path, change: impl FnOnce(&str) -> anyhow::Result<String>) -> anyhow::Result<()> {
    let text = fs::read_to_string(path)
        .with_context(|| format!("cannot read the configuration {}", path.display()))?;
    let changed = change(&text)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    Config::parse(&changed, folder)
        .map_err(|problems| ConfigError { path: path.to_owned(), problems })
        .context(
            "the changed configuration would not be valid, so that the file stays as it was",
        )?;
    ConfigFile::new(Some(path.to_owned()), text).replace(changed)?;
    Ok(())
}

fn read_password() -> anyhow::Result<String> {
    let password = if io::stdin().is_terminal() {
        rpassword::prompt_password("password: ").context("cannot read a password")?
    } else {
        let mut line = String::new();
        io::stdin().lock().read_line(&mut line).context("cannot read a password")?;
        line.trim_end_matches(['\n', '\r']).to_owned()
    };
    if password.chars().count() < MIN_PASSWORD_LEN {
        bail!(
            "expected a password of at least {MIN_PASSWORD_LEN} characters on the standard input, found {}",
            password.chars().count()
        );
    }
    Ok(password)
}

fn password_hash(password: &str) -> anyhow::Result<String> {
    let hash = Argon2::default().hash_password(password.as_bytes());
    Ok(hash.context("cannot hash the password")?.to_string())
}
