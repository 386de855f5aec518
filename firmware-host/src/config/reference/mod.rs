//! What every setting means, from the doc comments of the types that hold them (collected by
//! `build/reference.rs`).

mod page;
mod print;
mod strict;
mod words;

pub use page::reference_page;
pub(super) use print::commented;
pub(super) use strict::check_keys;
pub use strict::{Unknown, UnknownKind};
pub use words::{SettingDoc, ValidRange};

use std::collections::VecDeque;

/// A type of the configuration.
#[derive(Debug)]
struct TypeDoc {
    name: &'static str,
    doc: &'static str,
    /// Key that says which variant a table is.
    tag: Option<&'static str>,
    fields: &'static [FieldDoc],
    variants: &'static [VariantDoc],
}

/// A variant of an enum: one of a setting's words, or one kind of a table.
#[derive(Debug)]
struct VariantDoc {
    name: &'static str,
    doc: &'static str,
    fields: &'static [FieldDoc],
}

/// A key of a table.
#[derive(Debug)]
struct FieldDoc {
    key: &'static str,
    doc: &'static str,
    type_name: &'static str,
    optional: bool,
}

/// Sorted by name.
static TYPES: &[TypeDoc] = include!(concat!(env!("OUT_DIR"), "/config_reference.rs"));

fn type_doc(name: &str) -> Option<&'static TypeDoc> {
    TYPES.binary_search_by(|of| of.name.cmp(name)).ok().map(|k| &TYPES[k])
}

impl TypeDoc {
    /// Whether it is a text out of several.
    fn is_choice(&self) -> bool {
        self.tag.is_none() && !self.variants.is_empty()
    }

    /// The table's keys; those of `kind` where it has several kinds, those of all without it.
    fn keys(&'static self, kind: Option<&str>) -> impl Iterator<Item = &'static FieldDoc> {
        let of_kind = move |variant: &&VariantDoc| kind.is_none_or(|kind| kind == variant.name);
        let of_variants: Vec<_> = self.variants.iter().filter(of_kind).flat_map(|v| v.fields).collect();
        self.fields.iter().chain(of_variants)
    }
}

impl FieldDoc {
    fn of(&self) -> Option<&'static TypeDoc> {
        type_doc(self.type_name)
    }

    /// The type of the table that the key holds; none for numbers, texts and choices.
    fn table(&self) -> Option<&'static TypeDoc> {
        self.of().filter(|of| !of.is_choice())
    }
}

/// Every setting of the configuration, tables and all kinds of tables included, as `task.insertion_depth_mm`.
#[must_use]
pub fn settings() -> Vec<SettingDoc> {
    settings_of("Config")
}

fn settings_of(root: &str) -> Vec<SettingDoc> {
    let mut found = Vec::new();
    let mut tables = VecDeque::from([(String::new(), type_doc(root))]);
    while let Some((prefix, of)) = tables.pop_front() {
        let Some(of) = of else { continue };
        if let Some(tag) = of.tag {
            found.push(SettingDoc::new(format!("{prefix}{tag}"), None, of.doc));
        }
        let own = of.fields.iter().map(|field| (None, field));
        let kinds = of.variants.iter().flat_map(|v| v.fields.iter().map(move |field| (Some(v.name), field)));
        for (kind, field) in own.chain(kinds) {
            let path = format!("{prefix}{}", field.key);
            let mut setting = SettingDoc::new(path, kind, field.doc);
            setting.optional = field.optional;
            setting.table = field.table().is_some();
            setting.choices = field
                .of()
                .filter(|of| of.is_choice())
                .map_or(Vec::new(), |of| of.variants.iter().map(|v| (v.name, words::plain(v.doc))).collect());
            // Several kinds of a table may have the same table within.
            let is_new = !found.iter().any(|known: &SettingDoc| known.path == setting.path);
            if let Some(table) = field.table().filter(|_| is_new) {
                tables.push_back((format!("{}.", setting.path), Some(table)));
            }
            found.push(setting);
        }
    }
    found
}

/// What a table of this path is for.
fn field_at(path: &str) -> Option<&'static FieldDoc> {
    let (mut of, mut found) = (type_doc("Config")?, None);
    for key in path.split('.') {
        let field = of.keys(None).find(|field| field.key == key)?;
        found = Some(field);
        match field.table() {
            Some(table) => of = table,
            None => break,
        }
    }
    found
}
