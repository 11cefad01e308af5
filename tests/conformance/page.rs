//! `docs/conformance.md`, written from the table, and what must hold for the table itself.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

use crate::DOCUMENTS;
use crate::table::{Cell, Document, Row};

const HEAD: &str = "\
# Conformance

What the source documents of the drives say, sentence by sentence in our own words, and how it is known that the simulated
drive and the library do it. This page is generated from the tables in `tests/conformance/`; change those.

Each cell names a test of `cargo test --test conformance` and, behind the arrow, the mutation of `tests/mutants.toml` that turns
this very test red. Each test named here has to fail with its mutation (`cargo xtask mutants`). The simulated drive's
tests give it objects and controlwords and look at its statusword, its position and its ledger of executed set-points. The
library's tests look at the words on the wire, at what is reported, and at that ledger.
";

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn rows() -> impl Iterator<Item = &'static Row> {
    DOCUMENTS.iter().flat_map(|document| document.rows)
}

fn cells() -> impl Iterator<Item = &'static Cell> {
    rows().flat_map(|row| [&row.drive, &row.library])
}

fn page() -> String {
    let mutations: BTreeSet<_> = cells().filter_map(|cell| Some(cell.test()?.1)).collect();
    let mut page = HEAD.to_owned();
    let _ = write!(
        page,
        "\n{} rows, {} tests, {} mutations.\n",
        rows().count(),
        cells().filter_map(Cell::test).count(),
        mutations.len()
    );
    for document in DOCUMENTS {
        write_document(&mut page, document);
    }
    page
}

fn write_document(page: &mut String, document: &Document) {
    let _ = write!(page, "\n## {}\n\n{}\n\n", document.title, document.about);
    page.push_str(
        "| row | where | what it says | simulated drive | library |\n|---|---|---|---|---|\n",
    );
    for row in document.rows {
        let _ = writeln!(
            page,
            "| {} | {} | {} | {} | {} |",
            row.id,
            row.section,
            row.says,
            cell(&row.drive),
            cell(&row.library)
        );
    }
    if !document.without_row.is_empty() {
        page.push_str("\nWithout a row:\n\n");
        for (what, why) in document.without_row {
            let _ = writeln!(page, "- {what}: {why}");
        }
    }
}

fn cell(cell: &Cell) -> String {
    match cell {
        Cell::NoPart(reason) => format!("– {reason}"),
        Cell::By { .. } => cell.test().map_or(String::new(), |(test, mutation)| {
            format!("`{test}` ← `{mutation}`")
        }),
    }
}

#[test]
fn the_page_shows_the_table() {
    let path = root().join("docs/conformance.md");
    let page = page();
    if std::env::var_os("WRITE_CONFORMANCE").is_some() {
        fs::write(&path, &page).expect("docs/ can be written");
    }
    let committed = fs::read_to_string(&path).unwrap_or_default();
    assert!(
        committed == page,
        "docs/conformance.md is not what the table says; write it with\n    \
         WRITE_CONFORMANCE=1 cargo test --test conformance the_page_shows_the_table"
    );
}

#[test]
fn every_row_is_complete_and_has_a_name_of_its_own() {
    let mut ids = BTreeSet::new();
    for row in rows() {
        assert!(ids.insert(row.id), "{} twice", row.id);
        for text in [row.id, row.section, row.says] {
            assert!(
                !text.trim().is_empty() && !text.contains('|') && !text.contains('\n'),
                "{}: {text:?}",
                row.id
            );
        }
        assert!(
            row.drive.test().is_some() || row.library.test().is_some(),
            "{} has no test",
            row.id
        );
    }
}

#[test]
fn every_test_is_named_by_one_row() {
    let mut tests = BTreeSet::new();
    for (test, _) in cells().filter_map(Cell::test) {
        assert!(tests.insert(test), "{test} stands for two rows");
    }
}

#[test]
fn every_mutation_is_there_and_every_one_there_is_used() {
    let text = fs::read_to_string(root().join("tests/mutants.toml")).expect("tests/mutants.toml");
    let table: toml::Table = text.parse().expect("TOML");
    let rows = table["mutant"].as_array().expect("rows");
    let id = |row: &toml::Value| row["id"].as_str().expect("an id").to_owned();
    let there: BTreeSet<_> = rows.iter().map(id).collect();
    let own = rows.iter().filter(|row| row.get("test").is_none());
    let own: BTreeSet<_> = own.map(id).collect();
    let named: BTreeSet<String> = cells()
        .filter_map(|cell| Some(cell.test()?.1.to_owned()))
        .collect();
    let missing: Vec<_> = named.difference(&there).collect();
    assert!(missing.is_empty(), "tests/mutants.toml has no {missing:?}");
    let unused: Vec<_> = own.difference(&named).collect();
    assert!(unused.is_empty(), "no row names {unused:?}");
}
