//! The configuration as TOML with a comment on every setting.

use super::words::{first_sentence, plain, without_default};
use super::{FieldDoc, TypeDoc, field_at, type_doc};
use std::fmt::Write;

/// Longest line of a comment.
const COLUMNS: usize = 100;

/// Adds comments to a configuration's own TOML. Settings and tables that are not set are listed as comments.
pub(crate) fn commented(toml: &str) -> String {
    let mut out = String::new();
    let mut prefix = String::new();
    let mut unset = type_doc("Config").map(|of| Unset::of(of, "")).unwrap_or_default();
    for line in toml.lines() {
        if let Some(table) = line.strip_prefix('[').and_then(|line| line.strip_suffix(']')) {
            unset.finish(&mut out);
            prefix = format!("{table}.");
            let field = field_at(table);
            unset = field.and_then(FieldDoc::table).map(|of| Unset::of(of, &prefix)).unwrap_or_default();
            blank_line(&mut out);
            if let Some(field) = field {
                comment(&mut out, "# ", &without_default(&plain(field.doc)));
            }
        } else if let Some((key, value)) = line.split_once(" = ") {
            unset.set(key, value);
            describe(&mut out, &prefix, key);
        }
        if !line.is_empty() {
            out += line;
            out.push('\n');
        }
    }
    unset.finish(&mut out);
    out
}

/// What is said of a key before its line.
fn describe(out: &mut String, prefix: &str, key: &str) {
    blank_line(out);
    if let Some(field) = field_at(&format!("{prefix}{key}")) {
        comment(out, "# ", &without_default(&plain(field.doc)));
        if let Some(of) = field.of().filter(|of| of.is_choice()) {
            choices(out, of);
        }
        return;
    }
    let table = field_at(prefix.trim_end_matches('.')).and_then(FieldDoc::table);
    if let Some(of) = table.filter(|of| of.tag == Some(key)) {
        comment(out, "# ", &without_default(&plain(of.doc)));
        choices(out, of);
    }
}

fn choices(out: &mut String, of: &TypeDoc) {
    for variant in of.variants {
        comment(out, "#   ", &format!("\"{}\": {}", variant.name, first_sentence(&plain(variant.doc))));
    }
}

/// Keys of a table that have not been written yet.
#[derive(Default)]
struct Unset {
    prefix: String,
    of: Option<&'static TypeDoc>,
    seen: Vec<String>,
    kind: Option<String>,
}

impl Unset {
    fn of(of: &'static TypeDoc, prefix: &str) -> Self {
        Self { prefix: prefix.to_owned(), of: Some(of), ..Self::default() }
    }

    fn set(&mut self, key: &str, value: &str) {
        self.seen.push(key.to_owned());
        if self.of.is_some_and(|of| of.tag == Some(key)) {
            self.kind = Some(value.trim_matches('"').to_owned());
        }
    }

    /// Lists what the table may hold besides. Tables are listed where they would stand.
    fn finish(&self, out: &mut String) {
        let Some(of) = self.of else { return };
        for field in of.keys(Some(self.kind.as_deref().unwrap_or(""))) {
            if !field.optional || self.seen.iter().any(|seen| seen == field.key) {
                continue;
            }
            blank_line(out);
            if field.table().is_some() {
                let text = format!("Not set: [{}{}]. {}", self.prefix, field.key, plain(field.doc));
                comment(out, "# ", &text);
            } else {
                comment(out, "# ", &plain(field.doc));
                let _ = writeln!(out, "# {} =", field.key);
            }
        }
        for variant in of.variants.iter().filter(|v| of.tag.is_some() && Some(v.name) != self.kind.as_deref())
        {
            if variant.fields.is_empty() {
                continue;
            }
            blank_line(out);
            let tag = of.tag.unwrap_or_default();
            comment(out, "# ", &format!("With {tag} = \"{}\": {}", variant.name, plain(variant.doc)));
            for field in variant.fields {
                comment(out, "#   ", &format!("{}: {}", field.key, plain(field.doc)));
            }
        }
    }
}

/// Text in lines of comments.
fn comment(out: &mut String, start: &str, text: &str) {
    for paragraph in text.lines().filter(|line| !line.trim().is_empty()) {
        let mut line = start.to_owned();
        for word in paragraph.split_whitespace() {
            if line.len() + word.len() > COLUMNS && line.len() > start.len() {
                out.push_str(line.trim_end());
                out.push('\n');
                line = start.to_owned();
            }
            line += word;
            line.push(' ');
        }
        out.push_str(line.trim_end());
        out.push('\n');
    }
}

fn blank_line(out: &mut String) {
    if !out.is_empty() && !out.ends_with("\n\n") {
        out.push('\n');
    }
}
