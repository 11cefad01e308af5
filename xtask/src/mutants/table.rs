//! The rows of `tests/mutants.toml`, and the tests that `tests/conformance/ROWS.md` names for them.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;
use std::str::FromStr;

use serde::Deserialize;

/// The page that names the tests of the conformance suite.
const CONFORMANCE: &str = "tests/conformance/ROWS.md";

/// A known way to get it wrong, and how it is known that it would be seen.
#[derive(Debug)]
pub(crate) struct Mutant {
    pub(crate) id: String,
    /// Each of them fails with the mutant.
    pub(crate) tests: BTreeMap<Target, BTreeSet<String>>,
    pub(crate) edits: Vec<Edit>,
}

impl Mutant {
    /// One that is in no table, and that any test may catch.
    pub(crate) fn outside_the_table(name: &str) -> Self {
        Self {
            id: name.to_owned(),
            tests: BTreeMap::new(),
            edits: Vec::new(),
        }
    }

    /// What stands for the id in the rewritten code: the same whatever rows are added before it.
    pub(crate) fn number(&self) -> u32 {
        let hash = self.id.bytes().fold(0x811C_9DC5_u32, |hash, byte| {
            (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193)
        });
        // 0 is no mutant; the highest two say that it was not read yet, and that each is written down.
        hash.clamp(1, u32::MAX - 2)
    }
}

/// What is wrong with a mutant, or with what else is named.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Fault {
    /// The id, or the file or suite.
    pub(crate) of: String,
    what: String,
}

impl Fault {
    pub(crate) fn new(of: &dyn fmt::Display, what: impl Into<String>) -> Self {
        Self {
            of: of.to_string(),
            what: what.into(),
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.of, self.what)
    }
}

/// One change of the code.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Edit {
    pub(crate) file: String,
    /// The function, or another item, by its path inside the file.
    pub(crate) function: String,
    /// Stands once in the function; white space counts as white space, whatever its length.
    pub(crate) find: String,
    pub(crate) replace: String,
}

/// What cargo builds an executable of tests from.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Target {
    pub(crate) package: String,
    /// `lib`, `test` or `example`.
    pub(crate) kind: &'static str,
    pub(crate) name: String,
}

impl Target {
    /// The library's own tests or those of `tests/`.
    pub(crate) fn source(&self, root: &Path) -> Option<std::path::PathBuf> {
        let package = root.join(self.directory());
        let directory = match self.kind {
            "lib" => return Some(package.join("src/lib.rs")),
            "test" => "tests",
            _ => "examples",
        };
        let one = package.join(directory).join(format!("{}.rs", self.name));
        let many = package.join(directory).join(&self.name).join("main.rs");
        [one, many].into_iter().find(|path| path.is_file())
    }

    /// The directory of the package, from the root.
    pub(crate) fn directory(&self) -> &'static str {
        match self.package.as_str() {
            "servocrab-sim" => "sim",
            "servocrab-attach" => "attach",
            "servocrab-cli" => "tools",
            _ => "",
        }
    }

    /// What cargo calls it on its command line.
    pub(crate) fn arguments(&self) -> Vec<String> {
        match self.kind {
            "lib" => vec!["--lib".to_owned()],
            kind => vec![format!("--{kind}"), self.name.clone()],
        }
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.package != "servocrab" {
            write!(f, "--package {} ", self.package)?;
        }
        f.write_str(&self.arguments().join(" "))
    }
}

/// A test as a row names it: `--test TARGET NAME`, `--lib NAME`, with `--package` before it for the simulator's.
struct Test {
    target: Target,
    name: String,
}

impl FromStr for Test {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let words: Vec<_> = text.split_whitespace().collect();
        let (package, words) = match words.as_slice() {
            ["--package", package, words @ ..] => (*package, words),
            words => ("servocrab", words),
        };
        let (kind, target, name) = match words {
            ["--lib", name] => ("lib", "", name),
            ["--test", target, name] => ("test", *target, name),
            ["--example", target, name] => ("example", *target, name),
            _ => {
                return Err(format!(
                    "`{text}` is not `--test TARGET NAME` and not `--lib NAME`"
                ));
            }
        };
        Ok(Self {
            target: Target {
                package: package.to_owned(),
                kind,
                name: target.to_owned(),
            },
            name: (*name).to_owned(),
        })
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    mutant: Vec<Row>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    id: String,
    why: String,
    /// None where only the conformance page names tests for it.
    test: Option<String>,
    edits: Vec<Edit>,
}

/// All rows, with what is wrong with them.
pub(crate) fn read(root: &Path) -> crate::Result<(Vec<Mutant>, Vec<Fault>)> {
    let text = std::fs::read_to_string(root.join("tests/mutants.toml"))?;
    let page = std::fs::read_to_string(root.join(CONFORMANCE))?;
    rows(&text, &page)
}

fn rows(text: &str, page: &str) -> crate::Result<(Vec<Mutant>, Vec<Fault>)> {
    let table: Table = toml::from_str(text)?;
    let mut page = of_the_page(page);
    let mut faults = Vec::new();
    let mut ids = BTreeSet::new();
    let mut numbers = BTreeSet::new();
    let mut mutants = Vec::new();
    for row in table.mutant {
        let mut tests: BTreeMap<Target, BTreeSet<String>> = BTreeMap::new();
        match row.test.as_deref().map(Test::from_str) {
            Some(Ok(test)) => {
                tests.entry(test.target).or_default().insert(test.name);
            }
            Some(Err(wrong)) => faults.push(Fault::new(&row.id, wrong)),
            None => {}
        }
        if let Some(rows) = page.remove(&row.id) {
            let target = Target {
                package: "servocrab".to_owned(),
                kind: "test",
                name: "conformance".to_owned(),
            };
            tests.entry(target).or_default().extend(rows);
        }
        if tests.is_empty() {
            faults.push(Fault::new(
                &row.id,
                format!("neither the row nor {CONFORMANCE} names a test"),
            ));
        }
        if row.why.trim().is_empty() {
            faults.push(Fault::new(&row.id, "no reason"));
        }
        if row.edits.is_empty() {
            faults.push(Fault::new(&row.id, "changes nothing"));
        }
        let mutant = Mutant {
            id: row.id,
            tests,
            edits: row.edits,
        };
        if !ids.insert(mutant.id.clone()) || !numbers.insert(mutant.number()) {
            faults.push(Fault::new(
                &mutant.id,
                "another row has this id or its number",
            ));
        }
        mutants.push(mutant);
    }
    for id in page.keys() {
        faults.push(Fault::new(
            id,
            format!("{CONFORMANCE} names it, but it has no row"),
        ));
    }
    Ok((mutants, faults))
}

/// The tests of the conformance suite by the id that the page shows behind the arrow: `` `test` ← `id` ``.
fn of_the_page(page: &str) -> BTreeMap<String, BTreeSet<String>> {
    let mut named: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    let pieces: Vec<_> = page.split('`').collect();
    for piece in pieces.windows(3) {
        if piece[1] == " ← " {
            named
                .entry(piece[2].to_owned())
                .or_default()
                .insert(piece[0].to_owned());
        }
    }
    named
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAGE: &str = "| row | `suite::a` ← `drive-a` | `suite::b` ← `drive-a` |\n| row | – none | `suite::c` ← `01-b` |";

    fn row(id: &str, more: &str) -> String {
        let edits = r#"edits = [{ file = "a.rs", function = "a", find = "1", replace = "2" }]"#;
        format!("[[mutant]]\nid = \"{id}\"\nwhy = \"A.\"\n{more}\n{edits}\n")
    }

    #[test]
    fn a_row_has_its_own_test_and_those_of_the_page() {
        let text = row("drive-a", "") + &row("01-b", r#"test = "--lib a::tests::b""#);
        let (mutants, faults) = rows(&text, PAGE).expect("a table");
        assert_eq!(faults, []);
        let of = |mutant: &Mutant| -> Vec<String> {
            let tests = mutant.tests.iter();
            tests
                .flat_map(|(target, tests)| {
                    tests.iter().map(move |test| format!("{target} {test}"))
                })
                .collect()
        };
        assert_eq!(
            of(&mutants[0]),
            ["--test conformance suite::a", "--test conformance suite::b"]
        );
        assert_eq!(
            of(&mutants[1]),
            ["--lib a::tests::b", "--test conformance suite::c"]
        );
    }

    #[test]
    fn the_page_and_the_table_name_each_other() {
        let text = row("drive-a", "") + &row("drive-unused", "") + &row("drive-a", "");
        let (_, faults) = rows(&text, PAGE).expect("a table");
        let faults: Vec<_> = faults.iter().map(ToString::to_string).collect();
        assert_eq!(
            faults,
            [
                "drive-unused: neither the row nor tests/conformance/ROWS.md names a test",
                "drive-a: neither the row nor tests/conformance/ROWS.md names a test",
                "drive-a: another row has this id or its number",
                "01-b: tests/conformance/ROWS.md names it, but it has no row",
            ]
        );
    }

    #[test]
    fn a_test_is_named_as_cargo_is_asked_for_it() {
        let named =
            |text: &str| Test::from_str(text).map(|test| format!("{} {}", test.target, test.name));
        for text in [
            "--test moves a::b",
            "--lib a::tests::b",
            "--package servocrab-sim --test program a",
        ] {
            assert_eq!(named(text).as_deref(), Ok(text));
        }
        assert!(named("moves a::b").is_err());
    }
}
