//! The copy of the tree in which the mutants are, and the directory into which cargo builds it.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::rewrite::{Change, File, Placed, Rewritten};
use super::table::{Fault, Mutant};
use crate::files::{self, listed, remove_others, write};

/// The packages that can have mutants, by their manifests.
const MANIFESTS: [(&str, &str); 3] = [
    ("Cargo.toml", "mutants"),
    ("attach/Cargo.toml", "../mutants"),
    ("sim/Cargo.toml", "../mutants"),
];

/// The crate that the rewritten code asks which mutant is on. With `MUTANT=each` none is, and it writes down the number of each that
/// would have been evaluated, as four bytes.
const SWITCH: &str = r#"//! Which mutant is on, and that it came to be evaluated.
use std::fs::File;
use std::io::Write;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};

/// Whether a choice was written down.
pub type Noted = AtomicBool;

const UNREAD: u32 = u32::MAX;
const EACH: u32 = UNREAD - 1;
static ACTIVE: AtomicU32 = AtomicU32::new(UNREAD);
static SEEN: OnceLock<File> = OnceLock::new();

/// The one that is on, where there is a choice among these.
#[inline]
pub fn among(these: &[u32], noted: &Noted) -> u32 {
    match ACTIVE.load(Relaxed) {
        UNREAD | EACH => first(these, noted),
        number => number,
    }
}

#[cold]
fn first(these: &[u32], noted: &Noted) -> u32 {
    let number = match ACTIVE.load(Relaxed) {
        UNREAD => read(),
        number => number,
    };
    if number == EACH && !noted.swap(true, Relaxed) && let Some(mut file) = SEEN.get() {
        for number in these {
            let _ = file.write_all(&number.to_le_bytes());
        }
    }
    number
}

/// Opens the file before it is needed: where a mutant is evaluated, the heap may be watched.
fn read() -> u32 {
    let number = match std::env::var("MUTANT").as_deref() {
        Ok("each") => EACH,
        Ok(number) => number.parse().unwrap_or(0),
        Err(_) => 0,
    };
    if let Some(file) = std::env::var_os("MUTANT_SEEN").and_then(|path| File::options().append(true).open(path).ok()) {
        let _ = SEEN.set(file);
    }
    ACTIVE.store(number, Relaxed);
    number
}

pub fn evaluated() {
    static TOLD: AtomicU32 = AtomicU32::new(0);
    if TOLD.swap(1, Relaxed) == 0 && let Some(mut file) = SEEN.get() {
        let _ = file.write_all(b"x");
    }
}
"#;

const SWITCH_MANIFEST: &str = "\
[package]
name = \"mutants\"
version = \"0.0.0\"
edition = \"2024\"
publish = false
";

/// All files with mutants, and where these belong.
pub(crate) struct Sources<'a> {
    root: &'a Path,
    files: BTreeMap<String, File>,
    /// The edits of each mutant, by its place in the table, that have their place.
    placed: BTreeMap<(String, usize), Vec<Placed>>,
    mutants: &'a [Mutant],
}

/// Where a mutant that is in no table belongs. Lines and columns count from 1.
pub(crate) struct Place<'a> {
    pub(crate) file: &'a str,
    pub(crate) from: (usize, usize),
    pub(crate) to: (usize, usize),
    pub(crate) replace: &'a str,
}

impl<'a> Sources<'a> {
    /// Reads the files of mutants that are in no table, each with its place, and says which have none.
    pub(crate) fn at(
        root: &'a Path,
        mutants: &'a [Mutant],
        places: &[Place<'_>],
    ) -> (Self, Vec<Fault>) {
        let mut faults = Vec::new();
        let files = read_files(root, places.iter().map(|place| place.file), &mut faults);
        let mut placed: BTreeMap<_, Vec<_>> = BTreeMap::new();
        for (number, place) in places.iter().enumerate() {
            let file = files.get(place.file).ok_or("cannot be read".to_owned());
            match file.and_then(|file| file.place_at(place.from, place.to, place.replace)) {
                Ok(edit) => drop(placed.insert((place.file.to_owned(), number), vec![edit])),
                Err(wrong) => faults.push(Fault::new(&mutants[number].id, wrong)),
            }
        }
        let sources = Self {
            root,
            files,
            placed,
            mutants,
        };
        sources.parse(&mut faults);
        (sources, faults)
    }

    /// Whether one of these functions could no longer be constant with this mutant.
    pub(crate) fn keeps_from_constant(&self, mutant: u32, names: &BTreeSet<String>) -> bool {
        let others = self.mutants.iter().map(Mutant::number);
        let others = others.filter(|number| *number != mutant).collect();
        !self.no_longer_constant(&others).is_disjoint(names)
    }

    /// Reads the files that the rows name. What has no place in them is added to the faults.
    pub(crate) fn read(root: &'a Path, mutants: &'a [Mutant], faults: &mut Vec<Fault>) -> Self {
        let edits = mutants.iter().flat_map(|mutant| &mutant.edits);
        let files = read_files(root, edits.map(|edit| edit.file.as_str()), faults);
        let mut placed: BTreeMap<_, Vec<_>> = BTreeMap::new();
        for (number, mutant) in mutants.iter().enumerate() {
            for edit in &mutant.edits {
                let unread = || format!("{} cannot be read", edit.file);
                let file = files.get(&edit.file).ok_or_else(unread);
                match file.and_then(|file| file.place(edit)) {
                    Ok(edit_placed) => placed
                        .entry((edit.file.clone(), number))
                        .or_default()
                        .push(edit_placed),
                    Err(wrong) => faults.push(Fault::new(&mutant.id, wrong)),
                }
            }
        }
        let sources = Self {
            root,
            files,
            placed,
            mutants,
        };
        sources.parse(faults);
        sources
    }

    /// What has no choice, or is no Rust with a mutant in it, is a fault.
    fn parse(&self, faults: &mut Vec<Fault>) {
        let none = BTreeSet::new();
        for (name, file) in &self.files {
            let changes = self.changes(name, &BTreeSet::new());
            let rewritten = file.with_choices(&changes, &none);
            if rewritten.is_ok_and(|rewritten| syn::parse_file(&rewritten.text).is_ok()) {
                continue;
            }
            for change in changes {
                let alone = file.with_choices(std::slice::from_ref(&change), &none);
                let parsed = alone.and_then(|alone| {
                    let parsed = syn::parse_file(&alone.text);
                    parsed.map_err(|error| format!("is no Rust: {error}"))
                });
                if let Err(wrong) = parsed {
                    faults.push(Fault::new(&change.id, wrong));
                }
            }
        }
    }

    /// Reads the other files that have constant functions: one that calls a function with a mutant is none any more.
    pub(crate) fn read_constant_functions(&mut self) -> crate::Result<()> {
        for name in listed(self.root)? {
            let place = self.root.join(&name);
            if !name.ends_with(".rs") || self.files.contains_key(&name) || !place.is_file() {
                continue;
            }
            let text = fs::read_to_string(place)?;
            if text.contains("const fn") {
                let file = File::read(text).map_err(|error| format!("{name}: {error}"))?;
                self.files.insert(name, file);
            }
        }
        Ok(())
    }

    /// The changes of a file that are chosen at run time, but for those that are left out.
    fn changes(&self, name: &str, without: &BTreeSet<u32>) -> Vec<Change<'a>> {
        let placed = self
            .placed
            .range((name.to_owned(), 0)..=(name.to_owned(), usize::MAX));
        placed
            .map(|((_, number), edits)| (&self.mutants[*number], edits))
            .filter(|(mutant, _)| !without.contains(&mutant.number()))
            .map(|(mutant, edits)| Change {
                id: &mutant.id,
                number: mutant.number(),
                edits: edits.clone(),
            })
            .collect()
    }

    /// The names of the functions that are no longer constant.
    fn no_longer_constant(&self, without: &BTreeSet<u32>) -> BTreeSet<String> {
        let mut names = BTreeSet::new();
        loop {
            let found: BTreeSet<String> = self
                .files
                .iter()
                .flat_map(|(name, file)| {
                    file.no_longer_constant(&self.changes(name, without), &names)
                })
                .collect();
            if found.is_subset(&names) {
                return names;
            }
            names.extend(found);
        }
    }

    /// The files of a mutant as they are with it alone.
    fn with(&self, mutant: usize) -> impl Iterator<Item = (&str, String)> {
        let placed = self.placed.iter().filter(move |((_, of), _)| *of == mutant);
        placed.map(|((name, _), edits)| (name.as_str(), self.files[name].with(edits)))
    }
}

fn read_files<'a>(
    root: &Path,
    names: impl Iterator<Item = &'a str>,
    faults: &mut Vec<Fault>,
) -> BTreeMap<String, File> {
    let mut files = BTreeMap::new();
    for name in names.collect::<BTreeSet<_>>() {
        let text = fs::read_to_string(root.join(name)).map_err(|error| error.to_string());
        match text.and_then(|text| File::read(text).map_err(|error| error.to_string())) {
            Ok(file) => drop(files.insert(name.to_owned(), file)),
            Err(error) => faults.push(Fault::new(&name, error)),
        }
    }
    files
}

/// The copy.
pub(crate) struct Tree {
    pub(crate) root: PathBuf,
    pub(crate) target: PathBuf,
    /// The lines of each rewritten file that belong to mutants.
    lines: BTreeMap<String, Rewritten>,
}

impl Tree {
    /// One in this directory.
    pub(crate) fn new(place: &Path) -> Self {
        Self {
            root: place.join("tree"),
            target: place.join("target"),
            lines: BTreeMap::new(),
        }
    }

    /// Brings the copy up to date, with the choice among all mutants but those that are left out. Only what differs is
    /// written, so that cargo builds only what differs.
    pub(crate) fn write(
        &mut self,
        sources: &Sources<'_>,
        without: &BTreeSet<u32>,
    ) -> crate::Result<()> {
        let names = sources.no_longer_constant(without);
        let mut files: BTreeSet<PathBuf> = BTreeSet::new();
        for name in &listed(sources.root)? {
            let source = sources.root.join(name);
            if !source.is_file() {
                continue;
            }
            files.insert(self.root.join(name));
            let manifest = MANIFESTS.iter().find(|(manifest, _)| manifest == name);
            let content = if let Some(file) = sources.files.get(name) {
                let rewritten = file.with_choices(&sources.changes(name, without), &names)?;
                let text = rewritten.text.clone().into_bytes();
                self.lines.insert(name.to_owned(), rewritten);
                text
            } else if let Some((_, switch)) = manifest {
                let dependency = format!("[dependencies]\nmutants = {{ path = \"{switch}\" }}\n");
                fs::read_to_string(&source)?
                    .replacen("[dependencies]\n", &dependency, 1)
                    .into_bytes()
            } else {
                fs::read(&source)?
            };
            write(&self.root.join(name), &content)?;
        }
        for (name, content) in [
            ("mutants/src/lib.rs", SWITCH),
            ("mutants/Cargo.toml", SWITCH_MANIFEST),
        ] {
            write(&self.root.join(name), content.as_bytes())?;
            files.insert(self.root.join(name));
        }
        files.insert(self.root.join("Cargo.lock"));
        remove_others(&self.root, &files)?;
        Ok(())
    }

    /// Puts a single mutant into the copy.
    pub(crate) fn put(&self, sources: &Sources<'_>, mutant: usize) -> io::Result<()> {
        for (name, text) in sources.with(mutant) {
            write(&self.root.join(name), text.as_bytes())?;
        }
        Ok(())
    }

    /// Takes it out again.
    pub(crate) fn take_out(&self, sources: &Sources<'_>, mutant: usize) -> io::Result<()> {
        for (name, _) in sources.with(mutant) {
            write(&self.root.join(name), self.lines[name].text.as_bytes())?;
        }
        Ok(())
    }

    /// The mutants in a line of a rewritten file.
    pub(crate) fn mutant_at(&self, file: &str, line: usize) -> Option<u32> {
        let lines = &self.lines.get(file)?.lines;
        lines
            .iter()
            .find(|(lines, _)| lines.contains(&line))
            .map(|(_, mutant)| *mutant)
    }

    /// Takes over what other steps have built of other packages.
    pub(crate) fn take_dependencies(&self, root: &Path) -> io::Result<()> {
        files::take_dependencies(root, &self.target)
    }
}

/// The text of a source file, or of all those in a directory.
pub(crate) fn text(place: &Path) -> String {
    let Ok(entries) = fs::read_dir(place) else {
        return fs::read_to_string(place).unwrap_or_default();
    };
    entries.flatten().map(|entry| text(&entry.path())).collect()
}
