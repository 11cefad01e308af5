//! `docs/pitfalls.md`: every pitfall, a test that finds it, and how many rows of `tests/mutants.toml` stand for it.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

/// The pitfalls seen in public DS402 masters and simulators, by their numbers: in our words, and the mutant whose test the page shows.
const PITFALLS: [(&str, &str); 38] = [
    (
        "Bit 4 falls and rises again before a frame is sent: the wire never shows it low",
        "01-no-low-between",
    ),
    (
        "Bit 4 is a pulse of one cycle, and bit 12 is not read",
        "02-one-cycle-pulse",
    ),
    (
        "Bit 4 is cleared only at an edge of bit 12, which may have passed",
        "03-edge-of-bit-12-only",
    ),
    (
        "The level of bit 12 counts as an acknowledge, though it was not seen low before",
        "04-level-of-bit-12",
    ),
    (
        "The wait for bit 12 to be low has no deadline",
        "05-no-deadline-idle",
    ),
    (
        "The wait for bit 12 to fall on a full buffer has no deadline",
        "06-no-deadline-full",
    ),
    (
        "The level of bit 10 counts as the arrival",
        "07-level-of-bit-10",
    ),
    (
        "The target is sent for one cycle, then the actual position again",
        "08-target-for-one-cycle",
    ),
    (
        "The relative bit is set and never cleared",
        "09-relative-stays",
    ),
    (
        "A move to the same target as before is not sent",
        "10-same-target-suppressed",
    ),
    (
        "A replacing move is sent without bit 5, or a waiting one with it",
        "11-no-bit-5",
    ),
    (
        "Profile parameters by SDO have no order with the edge, or a failed write is ignored",
        "12-sdo-not-awaited",
    ),
    (
        "Success is reported before anything was sent",
        "13-accepted-before-sent",
    ),
    ("A halt is never released", "14-halt-stays"),
    ("A halt is sent as a quick stop", "15-halt-is-quick-stop"),
    (
        "The mode is changed while the halt bit is set",
        "16-mode-change-under-halt",
    ),
    (
        "The state sequencing cancels a quick stop, or never leaves it",
        "17-quick-stop-cancelled",
    ),
    (
        "A quick stop first resets a fault, or enables the drive",
        "18-quick-stop-resets-the-fault",
    ),
    (
        "A stop waits behind a lock or a queue, or sends nothing",
        "19-cancel-sends-nothing",
    ),
    (
        "Bit 5 of the statusword is read in states that leave it undefined",
        "20-mask-6f-everywhere",
    ),
    (
        "Bit 5 is ignored: Quick stop active looks like Operation enabled",
        "21-bit-5-left-out",
    ),
    (
        "The whole statusword is compared, upper bits included",
        "22-whole-word",
    ),
    (
        "Ready to switch on is recognised only with the voltage bit",
        "23-voltage-required",
    ),
    (
        "Bit 7 is held high: there is no second edge",
        "24-bit-7-held",
    ),
    (
        "Faults are reset unasked, or without bound",
        "25-resets-unasked",
    ),
    (
        "Transitions follow each other without the statusword being read",
        "26-transitions-unread",
    ),
    (
        "The reserved bit of 6502h is not counted",
        "27-no-reserved-bit-4",
    ),
    (
        "Bit 4 of a homing stays high into the next mode",
        "28-bit-4-into-the-next-mode",
    ),
    (
        "The target is 0, or an old one, when the mode becomes active",
        "29-target-zero",
    ),
    (
        "A mapping is written before it was emptied, or outside PREOP",
        "30-not-emptied",
    ),
    (
        "Configuration errors are only logged, and the master waits for OP",
        "31-mapping-error-logged",
    ),
    (
        "More than eight entries are mapped on a drive that takes eight",
        "32-ninth-entry",
    ),
    ("A mapped 6060h is left at 0", "33-mode-left-at-0"),
    ("6068h is written as 32 bits", "34-6068h-as-32-bits"),
    (
        "Mappings in one direction only are refused",
        "35-one-direction",
    ),
    (
        "The objects or PDOs of a second axis are sought in the wrong place",
        "36-second-axis-offset",
    ),
    (
        "The SII's default mapping is taken for that of the object dictionary",
        "37-lengths-of-the-sii",
    ),
    (
        "A simulated drive never acknowledges, or moves on the target's level",
        "38-sim-never-acknowledges",
    ),
];

const HEAD: &str = "\
# Pitfalls

Mistakes found in public DS402 masters and simulators. Each has one or more mutants in `tests/mutants.toml`. A mutant puts the mistake
into a copy of this code, and names the test that finds it. CI demands that each of these tests fails with its mutant.

`cargo xtask mutants 07` runs the mutants of pitfall 7. The table has one test of each pitfall; the ids of the mutants begin with the
pitfall's number. A test in `tests/pitfalls/list.rs` writes this page.

| | pitfall | test | mutants |
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
    for (number, (pitfall, mutant)) in (1..).zip(PITFALLS) {
        let begins = format!("{number:02}-");
        let of_this = mutants.keys().filter(|name| name.starts_with(&begins));
        let count = of_this.count();
        let test = mutants.get(mutant).filter(|_| mutant.starts_with(&begins));
        let test = test.unwrap_or_else(|| panic!("pitfall {number} has no mutant {mutant}"));
        let _ = writeln!(page, "| {number} | {pitfall} | `{test}` | {count} |");
    }
    page
}

#[test]
fn every_pitfall_has_a_mutant_and_the_page_names_its_test() {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("docs/pitfalls.md");
    let page = page();
    if std::env::var_os("WRITE_PITFALLS").is_some() {
        fs::write(&path, &page).expect("docs/ can be written");
    }
    assert!(
        fs::read_to_string(&path).unwrap_or_default() == page,
        "docs/pitfalls.md is not what the table and tests/mutants.toml say; write it with\n    \
         WRITE_PITFALLS=1 cargo test --test pitfalls every_pitfall"
    );
}
