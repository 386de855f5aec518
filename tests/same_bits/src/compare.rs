//! Whether computed digests are the committed ones, and all of them.

use crate::Digests;
use alloc::string::{String, ToString};
use alloc::vec::Vec;
use core::fmt;

/// What is wrong with one name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Other bits.
    Differs {
        /// The digest's name.
        name: String,
        /// What was computed.
        found: u64,
        /// What was expected.
        committed: String,
    },
    /// A committed digest was not computed.
    NotComputed(String),
    /// A computed digest is not among the committed ones, or is there twice.
    NotCommitted(String),
    /// A group was asked for and gave no digest.
    NothingRan(String),
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Differs { name, found, committed } => {
                write!(f, "{name} differs: {found:016x}, committed {committed}")
            }
            Self::NotComputed(name) => write!(f, "{name} was not computed"),
            Self::NotCommitted(name) => write!(f, "{name} is not among the committed digests"),
            Self::NothingRan(group) => write!(f, "nothing ran of {group}"),
        }
    }
}

/// What came of a comparison.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Comparison {
    /// How many digests are equal, for each group.
    pub equal: Vec<(String, usize)>,
    /// All else.
    pub faults: Vec<Fault>,
}

impl Comparison {
    /// Whether every committed digest of the groups was computed and is equal, and there is at least one of
    /// each group.
    #[must_use]
    pub fn is_good(&self) -> bool {
        self.faults.is_empty() && !self.equal.is_empty()
    }
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.faults.iter().try_for_each(|fault| writeln!(f, "{fault}"))?;
        let equal: usize = self.equal.iter().map(|(_, count)| count).sum();
        write!(f, "{equal} digests are equal, {} are not (", self.faults.len())?;
        for (i, (group, count)) in self.equal.iter().enumerate() {
            write!(f, "{}{group} {count}", if i == 0 { "" } else { ", " })?;
        }
        write!(f, ")")
    }
}

/// Compares what was computed of some groups with the committed lines of those groups.
#[must_use]
pub fn compare(committed: &str, groups: &[&str], found: &Digests) -> Comparison {
    let lines: Vec<(&str, &str)> = committed.lines().filter_map(|line| line.split_once(' ')).collect();
    let group_of = |name: &str| name.split('/').next().unwrap_or_default().to_string();
    let mut out = Comparison::default();
    for &(name, _) in &lines {
        let is_asked = groups.contains(&group_of(name).as_str());
        if is_asked && !found.iter().any(|(other, _)| other == name) {
            out.faults.push(Fault::NotComputed(name.to_string()));
        }
    }
    for (i, (name, value)) in found.iter().enumerate() {
        let is_new = !found[..i].iter().any(|(other, _)| other == name);
        match lines.iter().find(|(other, _)| other == name) {
            Some((_, digest)) if is_new && u64::from_str_radix(digest, 16) == Ok(*value) => {}
            Some((_, digest)) if is_new => out.faults.push(Fault::Differs {
                name: name.clone(),
                found: *value,
                committed: digest.to_string(),
            }),
            _ => out.faults.push(Fault::NotCommitted(name.clone())),
        }
    }
    for &group in groups {
        let differs = |name: &str| {
            out.faults.iter().any(|fault| {
                matches!(fault,
                Fault::Differs { name: other, .. } | Fault::NotCommitted(other) if other == name)
            })
        };
        let of_group = found.iter().filter(|(name, _)| group_of(name) == group);
        let equal = of_group.clone().filter(|(name, _)| !differs(name)).count();
        out.equal.push((group.to_string(), equal));
        if of_group.count() == 0 {
            out.faults.push(Fault::NothingRan(group.to_string()));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec;

    const COMMITTED: &str = "a/one 0000000000000001\na/two 0000000000000002\nb/one 0000000000000003\n";

    fn found(list: &[(&str, u64)]) -> Digests {
        list.iter().map(|&(name, value)| (name.to_string(), value)).collect()
    }

    #[test]
    fn all_of_the_groups_that_are_asked_for_is_good() {
        let one = compare(COMMITTED, &["a"], &found(&[("a/one", 1), ("a/two", 2)]));
        assert!(one.is_good(), "{one}");
        assert_eq!(one.equal, vec![("a".to_string(), 2)]);
        assert!(
            compare(COMMITTED, &["a", "b"], &found(&[("b/one", 3), ("a/two", 2), ("a/one", 1)])).is_good()
        );
    }

    #[test]
    fn a_comparison_in_which_nothing_runs_fails() {
        assert!(!compare(COMMITTED, &[], &found(&[])).is_good());
        assert!(!compare("", &[], &found(&[])).is_good());
        let nothing = compare("", &["a"], &found(&[]));
        assert_eq!(nothing.faults, [Fault::NothingRan("a".to_string())]);
        assert_eq!(compare(COMMITTED, &["a"], &found(&[])).faults.len(), 3);
    }

    #[test]
    fn what_differs_is_missing_or_is_too_much_is_named() {
        let of = |list: &[(&str, u64)]| compare(COMMITTED, &["a"], &found(list));
        let differs = of(&[("a/one", 1), ("a/two", 3)]);
        assert_eq!(differs.equal, vec![("a".to_string(), 1)]);
        assert!(differs.to_string().contains("a/two differs: 0000000000000003, committed 0000000000000002"));
        assert_eq!(of(&[("a/one", 1)]).faults, [Fault::NotComputed("a/two".to_string())]);
        let unknown = Fault::NotCommitted("a/six".to_string());
        assert_eq!(of(&[("a/one", 1), ("a/two", 2), ("a/six", 6)]).faults, [unknown]);
        let twice = Fault::NotCommitted("a/one".to_string());
        assert_eq!(of(&[("a/one", 1), ("a/two", 2), ("a/one", 1)]).faults, [twice]);
    }
}
