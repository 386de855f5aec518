//! Reading a doc comment: sentences, the valid range and the default.

/// What is said of one setting.
#[derive(Clone, Debug, PartialEq)]
pub struct SettingDoc {
    /// Where it stands, for example `task.insertion_depth_mm`.
    pub path: String,
    /// Of which kind of its table, where that has several: `folder` for `source.path`.
    pub kind: Option<&'static str>,
    /// What it means, in which unit, and when to change it.
    pub text: String,
    /// Range of a number, as the text states it.
    pub valid: Option<ValidRange>,
    /// Whether it may be absent and then is.
    pub optional: bool,
    /// Whether it is a table of settings.
    pub table: bool,
    /// Words that it may be, and what each means.
    pub choices: Vec<(&'static str, String)>,
}

/// Smallest and largest valid number, both valid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ValidRange {
    /// Smallest.
    pub low: f64,
    /// Largest.
    pub high: f64,
}

impl SettingDoc {
    pub(super) fn new(path: String, kind: Option<&'static str>, doc: &str) -> Self {
        let text = plain(doc);
        let valid = ValidRange::stated(&text);
        Self { path, kind, text, valid, optional: false, table: false, choices: Vec::new() }
    }

    /// The default, as the text states it.
    #[must_use]
    pub fn stated_default(&self) -> Option<&str> {
        self.text.split_once("Default: `")?.1.split('`').next()
    }

    /// Whether it says when to change the setting.
    #[must_use]
    pub fn says_when(&self) -> bool {
        sentences(&self.text).any(|s| WHEN.iter().any(|word| s.starts_with(word)))
    }
}

/// How a sentence begins that says when to change a setting.
const WHEN: [&str; 6] = ["Change ", "Raise ", "Lower ", "Set ", "Keep ", "Leave "];

impl ValidRange {
    /// From a sentence `Valid: 0.1 to 1000 Hz`.
    fn stated(text: &str) -> Option<Self> {
        let (_, after) = text.split_once("Valid: ")?;
        let (low, rest) = after.split_once(" to ")?;
        let high: String = rest.chars().take_while(|c| c.is_ascii_digit() || "-.e".contains(*c)).collect();
        Some(Self { low: low.parse().ok()?, high: high.trim_end_matches('.').parse().ok()? })
    }

    /// Whether the number is within.
    #[must_use]
    pub fn contains(self, number: f64) -> bool {
        number >= self.low && number <= self.high
    }
}

/// A doc comment without links: "[`Pose`](crate::math::Pose)" becomes "`Pose`".
pub(super) fn plain(doc: &str) -> String {
    let mut out = String::with_capacity(doc.len());
    let mut rest = doc;
    while let Some(open) = rest.find("[`") {
        let (before, link) = rest.split_at(open);
        out += before;
        let Some(close) = link.find("`]") else { break };
        out += &link[1..=close];
        rest = &link[close + 2..];
        if rest.starts_with('(') {
            rest = rest.find(')').map_or(rest, |end| &rest[end + 1..]);
        }
    }
    out + rest
}

/// Sentences, each with its full stop. A stop within code ends none, nor does that of "Fig. 4".
pub(super) fn sentences(text: &str) -> impl Iterator<Item = &str> {
    let mut rest = text.trim();
    std::iter::from_fn(move || {
        let (sentence, after) = rest.split_at(end_of_sentence(rest));
        rest = after.trim_start();
        (!sentence.is_empty()).then(|| sentence.trim_end())
    })
}

fn end_of_sentence(text: &str) -> usize {
    let mut in_code = false;
    for (k, c) in text.char_indices() {
        in_code ^= c == '`';
        let after = text[k + c.len_utf8()..].trim_start_matches(' ');
        let begins = |c: char| c.is_uppercase() || matches!(c, '`' | '(' | '"' | '\n');
        let stop = c == '.' && text[k + 1..].starts_with([' ', '\n']) && after.starts_with(begins);
        if !in_code && (stop || c == '\n') {
            return k + 1;
        }
    }
    text.len()
}

/// The text without the sentence that states the default.
pub(super) fn without_default(text: &str) -> String {
    let kept: Vec<&str> = sentences(text).filter(|s| !s.starts_with("Default: ")).collect();
    kept.join(" ")
}

/// The first sentence.
pub(super) fn first_sentence(text: &str) -> &str {
    sentences(text).next().unwrap_or("")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_doc_comment_is_read_by_sentences() {
        let text = plain(
            "Rate of [`Pose`](crate::math::Pose), see [`Self`]. Valid: 0.1 to 1000 Hz. Default: `1.5`.",
        );
        assert_eq!(text, "Rate of `Pose`, see `Self`. Valid: 0.1 to 1000 Hz. Default: `1.5`.");
        assert_eq!(sentences(&text).count(), 3);
        assert_eq!(ValidRange::stated(&text), Some(ValidRange { low: 0.1, high: 1000.0 }));
        assert_eq!(without_default(&text), "Rate of `Pose`, see `Self`. Valid: 0.1 to 1000 Hz.");
        assert_eq!(
            ValidRange::stated("Valid: -1e-3 to 2.5; more"),
            Some(ValidRange { low: -1e-3, high: 2.5 })
        );
        assert_eq!(ValidRange::stated("Valid: above 0."), None);
    }
}
