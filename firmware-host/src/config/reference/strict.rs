//! Keys and words that the configuration does not have, with the one that was probably meant.

use super::{FieldDoc, TypeDoc, settings_of, type_doc};
use gelstereo_core::params::{renamed_setting, replaced_method};
use toml::de::{DeTable, DeValue};

/// Where the settings of the pipeline stand.
const PARAMS: &str = "params.";

/// A key or word that does not exist.
#[derive(Clone, Debug, PartialEq)]
pub struct Unknown {
    /// Line of the text, from 1.
    pub line: usize,
    /// Where it stands, for example `task.insertion_depth`.
    pub path: String,
    /// What it is.
    pub kind: UnknownKind,
    /// What may stand there.
    pub valid: Vec<String>,
    /// What was probably meant; several where they are equally near.
    pub suggestions: Vec<String>,
}

/// What does not exist.
#[derive(Clone, Debug, PartialEq)]
pub enum UnknownKind {
    /// There is no such key.
    Key,
    /// The key exists, but in a table of another kind.
    KeyOfOtherKind {
        /// The table's kind.
        kind: String,
        /// The kind that has the key.
        other: String,
    },
    /// The key has no such word.
    Word {
        /// What was found.
        found: String,
    },
}

impl std::fmt::Display for Unknown {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { line, path, kind, valid, suggestions } = self;
        match kind {
            UnknownKind::Key => write!(f, "line {line}: there is no setting `{path}`")?,
            UnknownKind::KeyOfOtherKind { kind, other } => {
                write!(
                    f,
                    "line {line}: `{path}` belongs to kind \"{other}\", but this table's kind is \"{kind}\""
                )?;
            }
            UnknownKind::Word { found } => write!(f, "line {line}: {path} is \"{found}\"")?,
        }
        if !suggestions.is_empty() {
            write!(f, "; did you mean `{}`?", suggestions.join("` or `"))?;
        }
        match (valid.is_empty(), suggestions.is_empty()) {
            (true, _) => Ok(()),
            (false, true) => write!(f, "; valid is one of {}", valid.join(", ")),
            (false, false) => write!(f, " (valid is one of {})", valid.join(", ")),
        }
    }
}

/// Checks all keys and words of a text against the type that it is to become. Values are not looked at, and
/// what is no TOML passes: reading it finds the fault.
pub(crate) fn check_keys(text: &str, root: &str) -> Result<(), Box<Unknown>> {
    let (Ok(table), Some(of)) = (DeTable::parse(text), type_doc(root)) else { return Ok(()) };
    Checker { text, root }.table(table.get_ref(), of, "")
}

struct Checker<'a> {
    text: &'a str,
    root: &'a str,
}

impl Checker<'_> {
    fn table(&self, table: &DeTable<'_>, of: &'static TypeDoc, prefix: &str) -> Result<(), Box<Unknown>> {
        let kind = self.kind(table, of, prefix)?;
        for (key, value) in table {
            let name: &str = key.get_ref();
            if of.tag == Some(name) {
                continue;
            }
            let path = format!("{prefix}{name}");
            let Some(field) = of.keys(kind.as_deref()).find(|field| field.key == name) else {
                return Err(Box::new(self.unknown_key(key.span().start, path, of, kind.as_deref())));
            };
            self.value(value.get_ref(), value.span().start, field, &path)?;
        }
        Ok(())
    }

    /// Which kind of table this is, where it has several and says so.
    fn kind(
        &self,
        table: &DeTable<'_>,
        of: &'static TypeDoc,
        prefix: &str,
    ) -> Result<Option<String>, Box<Unknown>> {
        let Some(tag) = of.tag else { return Ok(None) };
        let Some((_, value)) = table.iter().find(|(key, _)| key.get_ref() == tag) else { return Ok(None) };
        let DeValue::String(found) = value.get_ref() else { return Ok(None) };
        self.word(found, value.span().start, of, &format!("{prefix}{tag}"))?;
        Ok(Some(found.clone().into_owned()))
    }

    fn value(
        &self,
        value: &DeValue<'_>,
        start: usize,
        field: &'static FieldDoc,
        path: &str,
    ) -> Result<(), Box<Unknown>> {
        let Some(of) = field.of() else { return Ok(()) };
        match value {
            DeValue::Table(table) if !of.is_choice() => self.table(table, of, &format!("{path}.")),
            DeValue::String(found) if of.is_choice() => self.word(found, start, of, path),
            DeValue::Array(array) => {
                array.iter().try_for_each(|item| self.value(item.get_ref(), item.span().start, field, path))
            }
            _ => Ok(()),
        }
    }

    fn word(&self, found: &str, start: usize, of: &TypeDoc, path: &str) -> Result<(), Box<Unknown>> {
        if of.variants.iter().any(|variant| variant.name == found) {
            return Ok(());
        }
        let valid: Vec<&str> = of.variants.iter().map(|variant| variant.name).collect();
        Err(Box::new(Unknown {
            line: self.line(start),
            path: path.to_owned(),
            kind: UnknownKind::Word { found: found.to_owned() },
            suggestions: path
                .strip_prefix(PARAMS)
                .and_then(|path| replaced_method(path, found))
                .or_else(|| nearest(found, valid.iter().copied()))
                .map(str::to_owned)
                .into_iter()
                .collect(),
            valid: valid.into_iter().map(|word| format!("\"{word}\"")).collect(),
        }))
    }

    fn unknown_key(&self, start: usize, path: String, of: &'static TypeDoc, kind: Option<&str>) -> Unknown {
        let name = last(&path);
        let other = of.variants.iter().find(|v| v.fields.iter().any(|field| field.key == name));
        let line = self.line(start);
        if let (Some(kind), Some(other)) = (kind, other) {
            let kind = UnknownKind::KeyOfOtherKind { kind: kind.to_owned(), other: other.name.to_owned() };
            return Unknown { line, path, kind, suggestions: Vec::new(), valid: Vec::new() };
        }
        let renamed = path.strip_prefix(PARAMS).and_then(renamed_setting);
        let suggestions = match renamed {
            Some(present) => vec![format!("{PARAMS}{present}")],
            None => suggest(&path, &self.known(of, &path, kind)),
        };
        let here = of.tag.into_iter().chain(of.keys(kind).map(|field| field.key)).map(str::to_owned);
        let valid = if suggestions.is_empty() { here.collect() } else { Vec::new() };
        Unknown { line, path, kind: UnknownKind::Key, suggestions, valid }
    }

    /// Paths that may be meant: those of this table and kind first.
    fn known(&self, of: &'static TypeDoc, path: &str, kind: Option<&str>) -> Vec<String> {
        let prefix = path.rfind('.').map_or("", |dot| &path[..=dot]);
        let keys = of.tag.into_iter().chain(of.keys(kind).map(|field| field.key));
        let here = keys.map(|key| format!("{prefix}{key}"));
        let elsewhere = settings_of(self.root).into_iter().map(|setting| setting.path);
        here.chain(elsewhere.filter(|known| !same_table(known, prefix))).collect()
    }

    fn line(&self, start: usize) -> usize {
        self.text[..start.min(self.text.len())].matches('\n').count() + 1
    }
}

fn same_table(path: &str, prefix: &str) -> bool {
    path.rfind('.').map_or("", |dot| &path[..=dot]) == prefix
}

fn last(path: &str) -> &str {
    path.rsplit('.').next().unwrap_or(path)
}

/// Known paths that `path` is probably meant to be, of equal rank: the key may be misspelt, lack its unit, or
/// stand in another table.
fn suggest(path: &str, known: &[String]) -> Vec<String> {
    let key = last(path);
    let prefix = path.rfind('.').map_or("", |dot| &path[..=dot]);
    let cost = |candidate: &String| {
        let distance = distance(key, last(candidate))?;
        let elsewhere = !same_table(candidate, prefix);
        // In another table the key itself must be nearly right.
        let near = !elsewhere || 8 * distance <= 2 * key.len();
        let shared = candidate.split('.').zip(path.split('.')).take_while(|(a, b)| a == b).count();
        near.then_some((distance, elsewhere, std::cmp::Reverse(shared)))
    };
    let Some(lowest) = known.iter().filter_map(cost).min() else { return Vec::new() };
    let mut near: Vec<String> = Vec::new();
    for candidate in known.iter().filter(|candidate| cost(candidate) == Some(lowest)) {
        // Several kinds of a table may have the key.
        if !near.contains(candidate) && near.len() < MAX_SUGGESTIONS {
            near.push(candidate.clone());
        }
    }
    near
}

/// More do not help.
const MAX_SUGGESTIONS: usize = 3;

fn nearest<'a>(found: &str, words: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    words.filter_map(|word| Some((distance(found, word)?, word))).min().map(|(_, word)| word)
}

/// Edits between two keys, swapped letters counted as one; a missing unit or word at the end counts as one
/// too. `None` where the keys are not alike: more than a third of the longer one differs.
fn distance(found: &str, known: &str) -> Option<usize> {
    let starts = found.len() >= 2 && known.strip_prefix(found).is_some_and(|end| end.starts_with('_'));
    if starts {
        return Some(1);
    }
    let edits = strsim::damerau_levenshtein(&found.to_lowercase(), &known.to_lowercase());
    (3 * edits <= found.len().max(known.len())).then_some(edits)
}
