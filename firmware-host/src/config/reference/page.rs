//! The reference part of docs/configuration.md.

use super::words::{first_sentence, sentences, without_default};
use super::{SettingDoc, settings};
use crate::config::{Config, ConfigError};
use gelstereo_core::params::Params;
use std::fmt::Write;

/// Every setting in Markdown, table by table, with defaults and the words that it may be.
///
/// # Errors
/// [`ConfigError::Write`].
pub fn reference_page() -> Result<String, ConfigError> {
    let defaults = toml::Table::try_from(Config::default()).map_err(ConfigError::Write)?;
    let settings = settings();
    let mut tables: Vec<(&str, Vec<&SettingDoc>)> = Vec::new();
    for setting in &settings {
        let table = setting.path.rfind('.').map_or("", |dot| &setting.path[..dot]);
        // Effects and shapes are the simulator's, which has its own page.
        if is_elsewhere(table) {
            continue;
        }
        match tables.iter_mut().find(|(name, _)| *name == table) {
            Some((_, rows)) => rows.push(setting),
            None => tables.push((table, vec![setting])),
        }
    }
    let mut out = String::new();
    for (table, rows) in tables {
        section(&mut out, table, &rows, &settings, &defaults)?;
    }
    Ok(out)
}

fn is_elsewhere(table: &str) -> bool {
    table.starts_with("simulated.effects.") || table.starts_with("rig.") || table == "rig"
}

fn section(
    out: &mut String,
    table: &str,
    rows: &[&SettingDoc],
    all: &[SettingDoc],
    defaults: &toml::Table,
) -> Result<(), ConfigError> {
    let about = all.iter().find(|setting| setting.path == table);
    let title = if table.is_empty() { "First lines".to_owned() } else { format!("`[{table}]`") };
    let _ = writeln!(out, "### {title}\n");
    if let Some(about) = about {
        let _ = writeln!(out, "{}\n", about.text);
    }
    let _ = writeln!(out, "| key | default | meaning |\n|---|---|---|");
    for row in rows.iter().filter(|row| !row.table) {
        let key = row.path.rsplit('.').next().unwrap_or(&row.path);
        let kind = row.kind.map_or(String::new(), |kind| format!("With kind \"{kind}\": "));
        let text = format!("{kind}{}", without_default(&row.text));
        let default = default_of(row, defaults)?;
        let _ = writeln!(out, "| `{key}` | {default} | {} |", cell(&text));
        for (word, meaning) in &row.choices {
            let _ = writeln!(out, "| | `\"{word}\"` | {} |", cell(meaning));
        }
    }
    out.push('\n');
    let inner = rows.iter().filter(|row| row.table && is_elsewhere(&format!("{}.", row.path)));
    for row in inner {
        let _ = writeln!(out, "- `[{}]`: {}", row.path, first_sentence(&row.text));
    }
    if !out.ends_with("\n\n") {
        out.push('\n');
    }
    Ok(())
}

/// The default, and those of the presets that have another one.
fn default_of(row: &SettingDoc, defaults: &toml::Table) -> Result<String, ConfigError> {
    let path = row.path.as_str();
    let own = lookup(defaults, path).filter(|_| is_of_default(row, defaults));
    // What another kind of table would have is not in the default, but said of it.
    let stated = row.stated_default().filter(|_| row.kind.is_some()).map(|stated| format!("`{stated}`"));
    let shown = match &own {
        Some(value) => format!("`{value}`"),
        None => stated.unwrap_or_else(|| "not set".to_owned()),
    };
    let Some(setting) = path.strip_prefix("params.") else { return Ok(shown) };
    let mut others = String::new();
    for name in Params::PRESETS {
        let preset = Params::preset(name).unwrap_or_default();
        let preset = toml::Table::try_from(preset).map_err(ConfigError::Write)?;
        let value = lookup(&preset, setting);
        if value != own {
            let value = value.map_or("not set".to_owned(), |value| format!("`{value}`"));
            others += &format!("; {name}: {value}");
        }
    }
    Ok(shown + &others)
}

/// Whether the default's table is of the kind that has this key.
fn is_of_default(row: &SettingDoc, defaults: &toml::Table) -> bool {
    let Some(kind) = row.kind else { return true };
    let table = row.path.rfind('.').map_or("", |dot| &row.path[..=dot]);
    lookup(defaults, &format!("{table}kind")).is_some_and(|found| found.as_str() == Some(kind))
}

fn lookup(table: &toml::Table, path: &str) -> Option<toml::Value> {
    let (first, rest) = path.split_once('.').map_or((path, None), |(first, rest)| (first, Some(rest)));
    match (table.get(first)?, rest) {
        (toml::Value::Table(inner), Some(rest)) => lookup(inner, rest),
        (value, None) => Some(value.clone()),
        _ => None,
    }
}

/// A text in one cell of a table.
fn cell(text: &str) -> String {
    sentences(text).collect::<Vec<_>>().join(" ").replace('|', "\\|")
}
