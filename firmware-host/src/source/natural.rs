//! Natural order of file names: numbers in them compare as numbers, so that `left_3` precedes `left_29`.

use std::cmp::Ordering;

/// Part of a name.
enum Piece<'a> {
    /// Digits.
    Number(&'a str),
    /// Anything else.
    Text(&'a str),
}

/// Splits a name into alternating texts and numbers.
fn pieces(name: &str) -> impl Iterator<Item = Piece<'_>> {
    let mut rest = name;
    std::iter::from_fn(move || {
        let digits = rest.starts_with(|c: char| c.is_ascii_digit());
        let end = rest.find(|c: char| c.is_ascii_digit() != digits).unwrap_or(rest.len());
        let (piece, after) = rest.split_at(end);
        rest = after;
        match (piece.is_empty(), digits) {
            (true, _) => None,
            (false, true) => Some(Piece::Number(piece)),
            (false, false) => Some(Piece::Text(piece)),
        }
    })
}

/// Digits without leading zeros; empty for zero.
fn significant(digits: &str) -> &str {
    digits.trim_start_matches('0')
}

/// Compares numbers of any length.
fn compare_numbers(a: &str, b: &str) -> Ordering {
    let (a, b) = (significant(a), significant(b));
    a.len().cmp(&b.len()).then_with(|| a.cmp(b))
}

/// Compares names in natural order. Names that differ only in leading zeros compare as text, so that the
/// order is total.
pub(crate) fn compare(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (pieces(a), pieces(b));
    loop {
        let order = match (left.next(), right.next()) {
            (None, None) => return a.cmp(b),
            (None, Some(_)) => Ordering::Less,
            (Some(_), None) => Ordering::Greater,
            (Some(Piece::Number(a)), Some(Piece::Number(b))) => compare_numbers(a, b),
            (Some(Piece::Number(a) | Piece::Text(a)), Some(Piece::Number(b) | Piece::Text(b))) => a.cmp(b),
        };
        if order.is_ne() {
            return order;
        }
    }
}

/// Name with its numbers stripped of leading zeros: equal for `left_3` and `left_03`.
pub(super) fn without_leading_zeros(name: &str) -> String {
    let mut out = String::with_capacity(name.len());
    for piece in pieces(name) {
        out += match piece {
            Piece::Number(digits) if significant(digits).is_empty() => "0",
            Piece::Number(digits) => significant(digits),
            Piece::Text(text) => text,
        };
    }
    out
}

/// Number of missing names before each name, from the one number in which all of them differ.
///
/// The step is the smallest difference, so that every fifth frame of a recording has no gaps. All gaps
/// are zero if the names differ in more than one number, or if the differences are not multiples of the
/// step, as with timestamps.
pub(super) fn gaps(names: &[&str]) -> Vec<u64> {
    let steps = steps(names).unwrap_or_default();
    let step = steps.iter().copied().min().unwrap_or(0);
    if step == 0 || steps.iter().any(|s| s % step != 0) {
        return vec![0; names.len()];
    }
    std::iter::once(0).chain(steps.iter().map(|s| s / step - 1)).collect()
}

/// Differences of the one number in which neighbouring names differ; `None` if there is no such number.
fn steps(names: &[&str]) -> Option<Vec<u64>> {
    let split = |name: &'_ str| -> Vec<(bool, String)> {
        pieces(name)
            .map(|piece| match piece {
                Piece::Number(digits) => (true, significant(digits).to_owned()),
                Piece::Text(text) => (false, text.to_owned()),
            })
            .collect()
    };
    let all: Vec<_> = names.iter().map(|name| split(name)).collect();
    let mut place = None;
    for pair in all.windows(2) {
        let [before, after] = pair else { return None };
        if before.len() != after.len() {
            return None;
        }
        let mut differing = (0..before.len()).filter(|&k| before[k] != after[k]);
        let (here, None) = (differing.next()?, differing.next()) else { return None };
        if !(before[here].0 && after[here].0) || *place.get_or_insert(here) != here {
            return None;
        }
    }
    let place = place?;
    let number = |digits: &str| if digits.is_empty() { Some(0) } else { digits.parse::<u64>().ok() };
    let numbers = all.iter().map(|pieces| number(&pieces[place].1)).collect::<Option<Vec<u64>>>()?;
    numbers.windows(2).map(|pair| pair[1].checked_sub(pair[0])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sorted(names: &[&str]) -> Vec<String> {
        let mut names: Vec<String> = names.iter().map(|&name| name.to_owned()).collect();
        names.sort_by(|a, b| compare(a, b));
        names
    }

    /// In text order, left_29 would precede left_3.
    #[test]
    fn a_3_comes_before_a_29() {
        assert_eq!(sorted(&["left_29", "left_3", "left_10"]), ["left_3", "left_10", "left_29"]);
        assert_eq!(sorted(&["a", "a1b", "a01", "a1", ""]), ["", "a", "a01", "a1", "a1b"]);
        let longer_than_any_integer =
            ["f100000000000000000000000000000000000000000", "f99999999999999999999999999"];
        assert_eq!(
            sorted(&longer_than_any_integer),
            [longer_than_any_integer[1], longer_than_any_integer[0]]
        );
    }

    /// Python's `gelstereo.cli.files.natural_key` is tested against the same list.
    #[test]
    fn the_order_is_that_of_python() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/natural_order.txt");
        let text = std::fs::read_to_string(path).unwrap_or_default();
        let expected: Vec<&str> = text.lines().collect();
        assert!(expected.len() > 30, "{path}");
        let mut reversed = expected.clone();
        reversed.reverse();
        assert_eq!(sorted(&reversed), expected);
    }

    proptest! {
        /// Generated names sort like the tuples that they are made of.
        #[test]
        fn the_order_is_that_of_the_numbers(
            mut tuples in proptest::collection::vec(
                ("[a-c_-]{1,2}", 0u64..2000, "[a-c]{1,2}", any::<u64>()), 2..40,
            ),
            zeros in 0usize..4,
        ) {
            // Padding all numbers alike with zeros changes nothing.
            let name = |t: &(String, u64, String, u64)| {
                format!("{}{:0width$}{}{}", t.0, t.1, t.2, t.3, width = zeros)
            };
            let mut names: Vec<String> = tuples.iter().map(name).collect();
            names.sort_by(|a, b| compare(a, b));
            tuples.sort();
            prop_assert_eq!(names, tuples.iter().map(name).collect::<Vec<_>>());
        }

        /// Sorting needs a total order: antisymmetric, transitive, equal only for equal names.
        #[test]
        fn the_order_is_total(a in "[a0-2._]{0,8}", b in "[a0-2._]{0,8}", c in "[a0-2._]{0,8}") {
            prop_assert_eq!(compare(&a, &b), compare(&b, &a).reverse());
            prop_assert_eq!(compare(&a, &b).is_eq(), a == b);
            if compare(&a, &b).is_le() && compare(&b, &c).is_le() {
                prop_assert!(compare(&a, &c).is_le());
            }
        }

        /// The gaps of a number sequence equal the omitted numbers.
        #[test]
        fn gaps_are_those_left_out(
            first in 0u64..1000,
            step in 1u64..50,
            missing in proptest::collection::vec(0u64..4, 1..30),
            zeros in 0usize..6,
        ) {
            // The step is the smallest difference, so one pair without a gap is needed.
            let missing: Vec<u64> = std::iter::once(0).chain(missing).collect();
            let (mut number, mut names) = (first, vec![format!("cam2_{first:0zeros$}.x")]);
            for gap in &missing {
                number += step * (gap + 1);
                names.push(format!("cam2_{number:0zeros$}.x"));
            }
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            let expected: Vec<u64> = std::iter::once(0).chain(missing).collect();
            prop_assert_eq!(gaps(&names), expected);
        }
    }

    #[test]
    fn names_that_are_no_count_have_no_gaps() {
        assert_eq!(gaps(&["1700000000033", "1700000000066", "1700000000100"]), [0, 0, 0]);
        assert_eq!(gaps(&["a_1", "b_5"]), [0, 0]);
        assert_eq!(gaps(&["1_1", "2_5"]), [0, 0]);
        assert_eq!(gaps(&["one"]), [0]);
        assert_eq!(gaps(&[]), [0; 0]);
    }
}
