//! How much there is to read: files, code and restricted items by room, cycles between rooms, repeated names, and words per sentence
//! of each page. It fails above the bounds that it states.

mod pages;
mod rooms;

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

use rooms::SourceFile;

/// Measures the rooms of `src/` and the pages, and fails above the bounds.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Shows each import that is part of a cycle between rooms.
    #[arg(long)]
    imports: bool,
    /// Writes which rooms use which into docs/architecture.md, in place of comparing the page with them.
    #[arg(long)]
    write: bool,
}

/// Files in `src/`.
const MOST_FILES: usize = 181;
/// Items in `src/` that are `pub(crate)`, `pub(super)` or `pub(in …)`.
const MOST_RESTRICTED: usize = 654;
/// Types in `src/` of the same name.
const MOST_NAMESAKES: usize = 2;
/// The mean number of words in a sentence of a page, and of the documentation in a source file.
const MOST_WORDS: f64 = 16.0;
/// The words of any sentence of them.
const MOST_IN_A_SENTENCE: usize = 50;
/// Where the page about the rooms has what uses what.
const BEGIN: &str = "<!-- written by `cargo xtask house --write` -->\n";
const END: &str = "<!-- end -->\n";

#[derive(Default)]
struct Room {
    files: usize,
    code: usize,
    comments: usize,
    tests: usize,
    restricted: usize,
    public_types: usize,
}

pub(crate) fn run(args: &Args) -> crate::Result<()> {
    let root = crate::root();
    let files = sources(&root.join("src"))?;
    let mut rooms: BTreeMap<&str, Room> = BTreeMap::new();
    let mut types: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for file in &files {
        let room = rooms.entry(&file.room).or_default();
        room.files += 1;
        room.code += file.code;
        room.comments += file.comments;
        room.tests += file.tests;
        room.restricted += file.restricted;
        room.public_types += file.public_types;
        for name in &file.types {
            types.entry(name).or_default().insert(&file.path);
        }
    }
    show_rooms(&rooms);
    let mut faults = Vec::new();
    let total = |of: fn(&Room) -> usize| rooms.values().map(of).sum::<usize>();
    at_most(
        &mut faults,
        "files in src/",
        total(|room| room.files),
        MOST_FILES,
    );
    at_most(
        &mut faults,
        "restricted items",
        total(|room| room.restricted),
        MOST_RESTRICTED,
    );
    let mut names: Vec<_> = types
        .iter()
        .filter(|(_, places)| places.len() > MOST_NAMESAKES)
        .collect();
    names.sort_by_key(|(_, places)| core::cmp::Reverse(places.len()));
    println!("\ntypes of one name in more than {MOST_NAMESAKES} places");
    for (name, places) in &names {
        println!("  {name} ×{}: {}", places.len(), join(places.iter()));
    }
    at_most(&mut faults, "names of more than two types", names.len(), 0);
    let uses = arrows(&files);
    show_arrows(root, &uses, args.write, &mut faults)?;
    show_cycles(&files, &uses, args.imports, &mut faults);
    show_pages(root, &files, &mut faults)?;
    println!();
    if faults.is_empty() {
        println!("within all bounds");
        return Ok(());
    }
    for fault in &faults {
        println!("NOT MET: {fault}");
    }
    Err(format!("{} of the house's bounds are not met", faults.len()).into())
}

fn at_most(faults: &mut Vec<String>, what: &str, is: usize, most: usize) {
    if is > most {
        faults.push(format!("{what}: {is}, at most {most}"));
    }
}

fn join<'a>(names: impl Iterator<Item = &'a &'a str>) -> String {
    names.copied().collect::<Vec<_>>().join(", ")
}

fn show_rooms(rooms: &BTreeMap<&str, Room>) {
    println!(
        "{:20} {:>6} {:>7} {:>9} {:>6} {:>11} {:>13}",
        "room of src/", "files", "code", "comments", "tests", "restricted", "public types"
    );
    let mut all = Room::default();
    let line = |name: &str, room: &Room| {
        println!(
            "{name:20} {:>6} {:>7} {:>9} {:>6} {:>11} {:>13}",
            room.files, room.code, room.comments, room.tests, room.restricted, room.public_types
        );
    };
    for (name, room) in rooms {
        line(name, room);
        all.files += room.files;
        all.code += room.code;
        all.comments += room.comments;
        all.tests += room.tests;
        all.restricted += room.restricted;
        all.public_types += room.public_types;
    }
    line("all", &all);
}

/// Which rooms use which.
fn arrows(files: &[SourceFile]) -> BTreeMap<&str, BTreeSet<&str>> {
    let rooms: BTreeSet<&str> = files.iter().map(|file| file.room.as_str()).collect();
    let mut uses: BTreeMap<&str, BTreeSet<&str>> =
        rooms.iter().map(|&room| (room, BTreeSet::new())).collect();
    for file in files {
        for import in &file.imports {
            // An item of `bus` itself is named like a room in it.
            let whole = import.split('/').next().unwrap_or_default();
            let other = rooms.get(import.as_str()).or_else(|| rooms.get(whole));
            if let Some(&other) = other.filter(|other| **other != file.room) {
                uses.entry(&file.room).or_default().insert(other);
            }
        }
    }
    uses
}

/// Prints them, and compares the page about the rooms with them, or writes them there.
fn show_arrows(
    root: &Path,
    uses: &BTreeMap<&str, BTreeSet<&str>>,
    write: bool,
    faults: &mut Vec<String>,
) -> crate::Result<()> {
    let lines = uses.iter().filter(|(room, _)| **room != "lib");
    let lines = lines.map(|(room, others)| match others.is_empty() {
        true => format!("{room} → nothing\n"),
        false => format!("{room} → {}\n", join(others.iter())),
    });
    let drawn: String = lines.collect();
    println!("\nrooms that a room uses\n{drawn}");
    let path = root.join("docs/architecture.md");
    let page = fs::read_to_string(&path)?;
    let (before, rest) = page
        .split_once(BEGIN)
        .ok_or("docs/architecture.md lost its arrows")?;
    let (shown, after) = rest
        .split_once(END)
        .ok_or("docs/architecture.md lost its arrows")?;
    let drawn = format!("```text\n{drawn}```\n");
    if write {
        fs::write(&path, [before, BEGIN, &drawn, END, after].concat())?;
    } else if shown != drawn {
        faults.push(
            "docs/architecture.md shows other arrows than these: `cargo xtask house --write`"
                .into(),
        );
    }
    Ok(())
}

/// Which rooms reach each other both ways, directly or through others.
fn show_cycles(
    files: &[SourceFile],
    uses: &BTreeMap<&str, BTreeSet<&str>>,
    imports: bool,
    faults: &mut Vec<String>,
) {
    let rooms: BTreeSet<&str> = uses.keys().copied().collect();
    let knots = rooms::knots(&rooms, uses);
    println!("\nrooms that need each other");
    for knot in &knots {
        println!("  {}", join(knot.iter()));
        for file in files
            .iter()
            .filter(|file| knot.contains(file.room.as_str()))
        {
            for import in file
                .imports
                .iter()
                .filter(|import| imports && knot.contains(import.as_str()))
            {
                println!("    {} uses {import}", file.path);
            }
        }
    }
    at_most(faults, "cycles between rooms", knots.len(), 0);
}

fn show_pages(root: &Path, files: &[SourceFile], faults: &mut Vec<String>) -> crate::Result<()> {
    println!("\nwords per sentence: mean, longest");
    for page in markdown(root)? {
        let text = fs::read_to_string(&page)?;
        let name = page.strip_prefix(root).unwrap_or(&page).display();
        show_sentences(&name.to_string(), &pages::sentences(&text), faults);
    }
    for file in files {
        show_sentences(&format!("src/{}", file.path), &file.sentences, faults);
    }
    Ok(())
}

fn show_sentences(name: &str, lengths: &[usize], faults: &mut Vec<String>) {
    let (sum, count) = (lengths.iter().sum::<usize>(), lengths.len());
    if count == 0 {
        return;
    }
    let mean = sum as f64 / count as f64;
    let longest = lengths.iter().copied().max().unwrap_or(0);
    println!("  {mean:5.1} {longest:4}  {name}");
    if mean > MOST_WORDS {
        faults.push(format!(
            "words per sentence of {name}: {mean:.1}, at most {MOST_WORDS}"
        ));
    }
    at_most(
        faults,
        &format!("words in the longest sentence of {name}"),
        longest,
        MOST_IN_A_SENTENCE,
    );
}

fn sources(src: &Path) -> crate::Result<Vec<SourceFile>> {
    let mut paths = Vec::new();
    find(src, "rs", &mut paths)?;
    paths
        .iter()
        .map(|path| {
            let relative = path.strip_prefix(src)?;
            SourceFile::read(&fs::read_to_string(path)?, relative)
        })
        .collect()
}

/// All pages.
fn markdown(root: &Path) -> crate::Result<Vec<PathBuf>> {
    let pages = [
        "README.md",
        "CHANGELOG.md",
        "CONTRIBUTING.md",
        "attach/README.md",
        "fuzz/README.md",
        "sim/README.md",
        "tools/README.md",
    ];
    let mut pages = pages.map(|page| root.join(page)).to_vec();
    find(&root.join("docs"), "md", &mut pages)?;
    Ok(pages)
}

fn find(directory: &Path, extension: &str, found: &mut Vec<PathBuf>) -> crate::Result<()> {
    let mut entries: Vec<_> = fs::read_dir(directory)?.collect::<Result<_, _>>()?;
    entries.sort_by_key(fs::DirEntry::path);
    for entry in entries {
        let path = entry.path();
        if path.is_dir() {
            find(&path, extension, found)?;
        } else if path.extension().is_some_and(|other| other == extension) {
            found.push(path);
        }
    }
    Ok(())
}
