//! `docs/conformance.md` and `ROWS.md`, written from the tables, and what must hold for the tables themselves.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

use crate::DOCUMENTS;
use crate::table::{Cell, Document, Row};

/// Of the page, what is above its table.
const HEAD: &str = "\
# Conformance

Conformance means that two programs do what a drive's document says: the simulated drive, and the library that commands it. Each
sentence of a source page that describes a behaviour is a row, in our own words. Most rows have two tests:

- The simulated drive's test gives it objects and controlwords. It judges the statusword, the position and the ledger of executed
  set-points.
- The library's test runs it on that simulated drive. It judges the words on the wire, what the library reports, and the ledger.

Where a row has one test, it says why the other side has none. A test that cannot fail proves nothing. So each test has a mutation: a
defect of `tests/mutants.toml` with which this test has to fail.

";

/// And below it.
const TAIL: &str = "
The total counts a mutation once, where a page may share it with others.

The rows show that the simulated drives and the library agree with the documents as we read them. They do not show that a real drive
does what its document says: none of these tests has run on one. Where a page leaves something open, the row says what was assumed.
[drives.md](drives.md) has what no page says.

## The rows

[`tests/conformance/ROWS.md`](../tests/conformance/ROWS.md) is the long table. Each row has its place in the document, what the
document says there, both tests and their mutations. Below each document's rows is listed what has no row, and why.

The tables in `tests/conformance/*/mod.rs` are the source of both pages. A test writes the pages, and fails if they are out of date.

## How to run it

```sh
cargo test --test conformance                            # all tests
cargo test --test conformance akd2g_pp::stops            # those of one part
cargo xtask mutants drive-deaf-to-bit-8                  # one mutation: its tests have to fail
WRITE_CONFORMANCE=1 cargo test --test conformance page   # writes both pages
```

`.ci/run` runs all tests, and all mutations.
";

/// Of `ROWS.md`.
const ROWS_HEAD: &str = "\
# The rows of conformance

What the source documents of the drives say, and the tests of the simulated drive and of the library.
[Conformance](../../docs/conformance.md) says what they are for. A test writes this page from the tables beside it.

Each cell names a test of `cargo test --test conformance` and, behind the arrow, the mutation of `tests/mutants.toml` with which it
has to fail.
";

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn rows() -> impl Iterator<Item = &'static Row> + Clone {
    DOCUMENTS.iter().flat_map(|document| document.rows)
}

fn cells_of<'a>(
    rows: impl Iterator<Item = &'a Row> + Clone,
) -> impl Iterator<Item = &'a Cell> + Clone {
    rows.flat_map(|row| [&row.drive, &row.library])
}

fn cells() -> impl Iterator<Item = &'static Cell> {
    cells_of(rows())
}

/// How many rows, tests and mutations there are in these.
fn counts<'a>(rows: impl Iterator<Item = &'a Row> + Clone) -> String {
    let tests = cells_of(rows.clone()).filter_map(Cell::test);
    let mutations: BTreeSet<_> = tests.clone().map(|(_, mutation)| mutation).collect();
    let (tests, mutations) = (tests.count(), mutations.len());
    format!("{} | {tests} | {mutations}", rows.count())
}

fn page() -> String {
    let mut page = HEAD.to_owned();
    page.push_str("| source page | rows | tests | mutations |\n|---|---|---|---|\n");
    for document in DOCUMENTS {
        let counts = counts(document.rows.iter());
        let _ = writeln!(page, "| {} | {counts} |", document.title);
    }
    let _ = writeln!(page, "| all | {} |", counts(rows()));
    page + TAIL
}

fn long_table() -> String {
    let mut page = ROWS_HEAD.to_owned();
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
fn the_pages_show_the_tables() {
    for (path, page) in [
        ("docs/conformance.md", page()),
        ("tests/conformance/ROWS.md", long_table()),
    ] {
        if std::env::var_os("WRITE_CONFORMANCE").is_some() {
            fs::write(root().join(path), &page).expect("the page can be written");
        }
        let committed = fs::read_to_string(root().join(path)).unwrap_or_default();
        assert!(
            committed == page,
            "{path} is not what the tables say; write it with\n    \
             WRITE_CONFORMANCE=1 cargo test --test conformance page"
        );
    }
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
