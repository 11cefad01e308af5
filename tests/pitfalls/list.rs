//! `docs/pitfalls.md`: every pitfall with the rows of `tests/mutants.toml` that stand for it, and their tests.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

/// The pitfalls seen in public DS402 masters and simulators, in our words, by their numbers.
const PITFALLS: [&str; 38] = [
    "Bit 4 falls and rises again before one frame: the wire never shows it low",
    "Bit 4 is a pulse of one cycle, and bit 12 is not read",
    "Bit 4 is cleared at an edge of bit 12 only, which may have passed",
    "The level of bit 12 is taken for an answer without having been seen low",
    "Bit 12 is waited for to be low, without a deadline",
    "Bit 12 is waited for to fall on a full buffer, without a deadline",
    "The level of bit 10 is taken for the arrival",
    "The target is on the wire for one cycle, then the actual position again",
    "The relative bit is set and never cleared",
    "The same target as before is not sent",
    "A move that shall replace goes out without bit 5, or one that shall wait with it",
    "Profile parameters by SDO have no order with the edge, or a failed write is ignored",
    "Success is reported before anything was sent",
    "A halt is never released",
    "A halt is a quick stop in truth",
    "The mode is changed while the halt bit is set",
    "A quick stop is cancelled by the state sequencing, or never left",
    "A quick stop resets a fault, or enables the drive, in order to stop it",
    "A stop waits behind a lock or a queue, or sends nothing",
    "Bit 5 of the statusword is looked at in states that leave it undefined",
    "Bit 5 is left out: Quick stop active looks like Operation enabled",
    "The whole statusword is compared, upper bits included",
    "The voltage bit is required for Ready to switch on",
    "Bit 7 is held high: there is no second edge",
    "Faults are reset unasked, or without bound",
    "Transitions follow each other without the statusword being read",
    "The bits of 6502h are counted without the reserved one",
    "Bit 4 of a homing is left high into the next mode",
    "The target is 0, or an old one, when the mode becomes active",
    "A mapping is written without having been emptied, or outside PREOP",
    "Errors of the configuration are logged, and OP is waited for",
    "More than eight entries are mapped on a drive that takes eight",
    "A mapped 6060h is left at 0",
    "6068h is written as 32 bits",
    "Mappings in one direction only are refused",
    "The objects or PDOs of a second axis are looked for in the wrong place",
    "The default mapping of the SII is taken for that of the object dictionary",
    "A simulated drive never acknowledges, or moves on the target's level",
];

const HEAD: &str = "\
# Pitfalls

Mistakes that were found in public DS402 masters and simulators. For each, `tests/mutants.toml` has at least one row that puts it
into a copy of this code, and names the test that finds it. CI runs each of these tests with its mutant and demands that it fails
(`cargo xtask mutants`). This page is written from the rows by a test in `tests/pitfalls/list.rs`.

| | pitfall | mutant | found by |
|---|---|---|---|
";

/// The ids of `tests/mutants.toml`, and the test that each row names.
fn mutants() -> BTreeMap<String, String> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/mutants.toml");
    let text = fs::read_to_string(path).expect("tests/mutants.toml is there");
    let table: toml::Table = text.parse().expect("TOML");
    let rows = table["mutant"].as_array().expect("rows");
    let named = rows.iter().filter_map(|row| {
        let test = row.get("test")?.as_str()?.trim_start_matches("--test ");
        Some((row.get("id")?.as_str()?.to_owned(), test.to_owned()))
    });
    named.collect()
}

fn page() -> String {
    let mutants = mutants();
    let mut page = HEAD.to_owned();
    for (number, pitfall) in (1..).zip(PITFALLS) {
        let of_this = mutants
            .iter()
            .filter(|(name, _)| name.starts_with(&format!("{number:02}-")));
        let mut first = true;
        for (name, test) in of_this {
            let (number, pitfall) = if first {
                (number.to_string(), pitfall)
            } else {
                (String::new(), "")
            };
            first = false;
            let _ = writeln!(page, "| {number} | {pitfall} | `{name}` | `{test}` |");
        }
        assert!(!first, "pitfall {number} has no mutant");
    }
    page
}

#[test]
fn every_pitfall_has_a_defect_and_the_page_names_all_of_them() {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("docs/pitfalls.md");
    let page = page();
    if std::env::var_os("WRITE_PITFALLS").is_some() {
        fs::write(&path, &page).expect("docs/ can be written");
    }
    assert!(
        fs::read_to_string(&path).unwrap_or_default() == page,
        "docs/pitfalls.md is not what tests/mutants.toml says; write it with\n    \
         WRITE_PITFALLS=1 cargo test --test pitfalls every_pitfall"
    );
}
