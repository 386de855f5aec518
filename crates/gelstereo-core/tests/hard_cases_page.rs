//! The page of the hard cases names tests that exist.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeSet;
use std::path::Path;

/// Rows that the page must have.
const ROWS: [u32; 52] = [
    1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28,
    29, 30, 31, 32, 34, 35, 36, 37, 38, 39, 40, 41, 42, 43, 44, 45, 46, 47, 48, 49, 50, 51, 52, 53,
];

/// Names of the functions `row_...` and `test_row_...` in the sources below a folder.
fn collect(folder: &Path, names: &mut BTreeSet<String>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            collect(&path, names);
        } else if path.extension().is_some_and(|extension| extension == "rs" || extension == "py") {
            let text = std::fs::read_to_string(&path).unwrap();
            let functions = text.lines().filter_map(|line| {
                let line = line.trim_start();
                let rest = line.strip_prefix("fn ").or_else(|| line.strip_prefix("def "))?;
                rest.split_once('(').map(|(name, _)| name.to_owned())
            });
            names.extend(functions.filter(|name| name.starts_with("row_") || name.starts_with("test_row_")));
        }
    }
}

#[test]
fn every_test_that_the_page_names_exists() {
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut existing = BTreeSet::new();
    for folder in ["crates/gelstereo-core", "crates/gelstereo-sim", "firmware-host", "tests"] {
        collect(&repository.join(folder), &mut existing);
    }
    let page = std::fs::read_to_string(repository.join("docs/hard-cases.md")).unwrap();
    let mut rows = Vec::new();
    for line in page.lines() {
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        let Some(row) = cells.get(1).and_then(|cell| cell.parse::<u32>().ok()) else { continue };
        let (names, number) = (cells[3].split('`').skip(1).step_by(2), format!("row_{row:02}_"));
        for name in names.clone() {
            assert!(existing.contains(name), "row {row}: there is no test {name}");
            assert!(name.trim_start_matches("test_").starts_with(&number), "row {row}: {name}");
        }
        assert!(names.count() > 0, "row {row} names no test");
        rows.push(row);
    }
    assert_eq!(rows, ROWS);
}
