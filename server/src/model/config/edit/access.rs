//! Entries of `[[access]]` in a configuration's text.

use toml_edit::{Array, ArrayOfTables, Item, Table, Value, value};

use super::{EditError, parse};
use crate::model::access::Role;

const SECTION: &str = "access";

/// An entry to add.
pub struct NewEntry<'a> {
    pub name: &'a str,
    pub role: Role,
    /// For [`Role::Feed`].
    pub cameras: &'a [String],
    /// `token` or `password`, and its hash.
    pub proof: (&'a str, String),
    /// A date or time as in TOML.
    pub expires: Option<toml_edit::Datetime>,
}

pub fn add(text: &str, entry: NewEntry<'_>) -> Result<String, EditError> {
    let mut document = parse(text)?;
    let list = document.entry(SECTION).or_insert(Item::ArrayOfTables(ArrayOfTables::new()));
    let Item::ArrayOfTables(tables) = list else {
        return Err(EditError::Text(format!("`{SECTION}` is not written as [[{SECTION}]]")));
    };
    let mut table = Table::new();
    table.decor_mut().set_prefix("\n");
    table.insert("name", value(entry.name));
    table.insert("role", value(entry.role.word()));
    if entry.role == Role::Feed {
        table.insert("cameras", Item::Value(Value::Array(Array::from_iter(entry.cameras))));
    }
    table.insert(entry.proof.0, value(entry.proof.1));
    if let Some(expires) = entry.expires {
        table.insert("expires", value(expires));
    }
    tables.push(table);
    Ok(document.to_string())
}

pub fn remove(text: &str, name: &str) -> Result<String, EditError> {
    let mut document = parse(text)?;
    let missing = || EditError::Missing { what: "entry of [[access]]", name: name.to_owned() };
    let tables = document.get_mut(SECTION).and_then(Item::as_array_of_tables_mut);
    let tables = tables.ok_or_else(missing)?;
    let is_meant = |table: &Table| table.get("name").and_then(Item::as_str) == Some(name);
    let index = tables.iter().position(is_meant).ok_or_else(missing)?;
    tables.remove(index);
    if tables.is_empty() {
        document.remove(SECTION);
    }
    Ok(document.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "name = \"lab\" # the lab\n\n[server]\nlisten = \"127.0.0.1:0\"\n";

    #[test]
    fn an_entry_is_appended_and_removed_without_other_changes() {
        let entry = |name| NewEntry {
            name,
            role: Role::Feed,
            cameras: &[],
            proof: ("token", "sha256:00".to_owned()),
            expires: "2027-12-31".parse().ok(),
        };
        let one =
            add(TEXT, NewEntry { cameras: &["north".to_owned()], ..entry("node-1") }).unwrap();
        let added = "\n[[access]]\nname = \"node-1\"\nrole = \"feed\"\ncameras = [\"north\"]\n\
                     token = \"sha256:00\"\nexpires = 2027-12-31\n";
        assert_eq!(one, format!("{TEXT}{added}"));
        let two = add(&one, entry("node-2")).unwrap();
        assert_eq!(remove(&two, "node-2").unwrap(), one);
        assert_eq!(remove(&one, "node-1").unwrap(), TEXT);
        let error = remove(&one, "node-3").unwrap_err().to_string();
        assert!(error.contains("no entry of [[access]] \"node-3\""), "{error}");
    }
}
