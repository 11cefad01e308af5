//! What a source file of the library has in it.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use super::pages;
use proc_macro2::{TokenStream, TokenTree};
use syn::{
    Attribute, Item, ItemEnum, ItemMod, ItemStruct, ItemTrait, UseTree, Visibility,
    visit::{self, Visit},
};

/// One file below `src/`.
#[derive(Default)]
pub(super) struct SourceFile {
    /// Below `src/`.
    pub(super) path: String,
    /// The module below the root that it is of; below `bus` the next one too, as `bus/cycle`.
    pub(super) room: String,
    /// Lines, of each kind.
    pub(super) code: usize,
    pub(super) comments: usize,
    pub(super) tests: usize,
    /// Items and fields that are `pub(crate)`, `pub(super)` or `pub(in …)`.
    pub(super) restricted: usize,
    pub(super) public_types: usize,
    /// The names of its types.
    pub(super) types: BTreeSet<String>,
    /// What it names of other rooms, outside its tests: their names, or of `bus` that of an item in it.
    pub(super) imports: BTreeSet<String>,
    /// Words of each sentence of its documentation.
    pub(super) sentences: Vec<usize>,
}

/// The room of what has this path below the root.
fn room(path: &[String]) -> Option<String> {
    match path {
        [bus, inner, ..] if bus == "bus" => Some(format!("bus/{inner}")),
        [first, ..] => Some(first.clone()),
        [] => None,
    }
}

impl SourceFile {
    pub(super) fn read(text: &str, path: &Path) -> crate::Result<Self> {
        let name = path.display().to_string();
        let parts: Vec<String> = path
            .with_extension("")
            .iter()
            .map(|part| part.to_string_lossy().into_owned())
            .collect();
        let is_test = parts
            .iter()
            .any(|part| part == "tests" || part.ends_with("_tests") || part == "testing");
        let module: Vec<String> = match parts.last().map(String::as_str) {
            Some("mod" | "lib") => parts[..parts.len() - 1].to_vec(),
            _ => parts.clone(),
        };
        let mut file = Self {
            // The library's own file is a room as well.
            room: room(&module).unwrap_or_else(|| parts[0].clone()),
            path: name,
            sentences: documentation(text)
                .iter()
                .flat_map(|text| pages::sentences(text))
                .collect(),
            ..Self::default()
        };
        let parsed = syn::parse_file(text).map_err(|error| format!("{}: {error}", file.path))?;
        let test_lines = test_lines(&parsed);
        for (number, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() {
            } else if is_test || test_lines.iter().any(|lines| lines.contains(&(number + 1))) {
                file.tests += 1;
            } else if line.starts_with("//") {
                file.comments += 1;
            } else {
                file.code += 1;
            }
        }
        if !is_test {
            Reader {
                file: &mut file,
                module,
            }
            .visit_file(&parsed);
        }
        Ok(file)
    }
}

/// The comments of a file that document it, or an item of it: each a text in Markdown.
fn documentation(text: &str) -> Vec<String> {
    let mut texts: Vec<String> = Vec::new();
    let mut before = None;
    for line in text.lines().map(str::trim_start) {
        let kind = ["///", "//!"]
            .into_iter()
            .find(|kind| line.starts_with(kind));
        if let Some(kind) = kind {
            if before != Some(kind) {
                texts.push(String::new());
            }
            if let Some(text) = texts.last_mut() {
                let said = &line[kind.len()..];
                text.push_str(said.strip_prefix(' ').unwrap_or(said));
                text.push('\n');
            }
        }
        before = kind;
    }
    texts
}

fn is_test(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("cfg")
            && attribute
                .parse_args::<syn::Ident>()
                .is_ok_and(|name| name == "test")
    })
}

fn test_lines(file: &syn::File) -> Vec<core::ops::RangeInclusive<usize>> {
    file.items
        .iter()
        .filter_map(|item| match item {
            Item::Mod(module) if is_test(&module.attrs) => {
                let span = syn::spanned::Spanned::span(module);
                Some(span.start().line..=span.end().line)
            }
            _ => None,
        })
        .collect()
}

struct Reader<'a> {
    file: &'a mut SourceFile,
    /// The path of the module that is being read.
    module: Vec<String>,
}

impl Reader<'_> {
    fn note_type(&mut self, name: &syn::Ident, visibility: &Visibility) {
        self.file.types.insert(name.to_string());
        self.file.public_types += usize::from(matches!(visibility, Visibility::Public(_)));
    }

    /// A path that begins with these names: which room it leads to.
    fn note_path(&mut self, names: &[String]) {
        let path = match names.first().map(String::as_str) {
            Some("crate") => names[1..].to_vec(),
            Some("super") => {
                let up = names.iter().take_while(|name| *name == "super").count();
                let above = self.module.len().saturating_sub(up);
                [&self.module[..above], &names[up..]].concat()
            }
            _ => return,
        };
        let other = room(&path).filter(|room| *room != self.file.room);
        self.file.imports.extend(other);
    }

    /// Whether it is a handle that the public interface shows beside the pure types of this room, whose code does not name it: without
    /// `std` it is not there.
    fn is_for_users(&self, item: &syn::ItemUse) -> bool {
        let of_handles = matches!(&item.tree, UseTree::Path(krate) if krate.ident == "crate"
            && matches!(&*krate.tree, UseTree::Path(room) if room.ident == "handle"));
        matches!(item.vis, Visibility::Public(_)) && of_handles && self.module.len() == 1
    }

    fn note_use(&mut self, tree: &UseTree, before: &mut Vec<String>) {
        match tree {
            UseTree::Path(path) => {
                before.push(path.ident.to_string());
                self.note_use(&path.tree, before);
                before.pop();
            }
            UseTree::Group(group) => {
                for tree in &group.items {
                    self.note_use(tree, before);
                }
            }
            UseTree::Name(name) => {
                before.push(name.ident.to_string());
                self.note_path(before);
                before.pop();
            }
            UseTree::Rename(rename) => {
                before.push(rename.ident.to_string());
                self.note_path(before);
                before.pop();
            }
            UseTree::Glob(_) => self.note_path(before),
        }
    }

    /// Paths in what a macro is given.
    fn note_tokens(&mut self, tokens: TokenStream) {
        let mut names: Vec<String> = Vec::new();
        for token in tokens {
            match token {
                TokenTree::Ident(name) => names.push(name.to_string()),
                TokenTree::Punct(mark) if mark.as_char() == ':' => {}
                TokenTree::Group(group) => {
                    self.note_path(&names);
                    names.clear();
                    self.note_tokens(group.stream());
                }
                _ => {
                    self.note_path(&names);
                    names.clear();
                }
            }
            if let Some(start) = names.iter().rposition(|name| name == "crate") {
                names.drain(..start);
            }
        }
        self.note_path(&names);
    }
}

impl<'ast> Visit<'ast> for Reader<'_> {
    fn visit_visibility(&mut self, visibility: &'ast Visibility) {
        self.file.restricted += usize::from(matches!(visibility, Visibility::Restricted(_)));
    }

    fn visit_item_mod(&mut self, module: &'ast ItemMod) {
        if is_test(&module.attrs) {
            return;
        }
        self.module.push(module.ident.to_string());
        visit::visit_item_mod(self, module);
        self.module.pop();
    }

    fn visit_item_struct(&mut self, item: &'ast ItemStruct) {
        self.note_type(&item.ident, &item.vis);
        visit::visit_item_struct(self, item);
    }

    fn visit_item_enum(&mut self, item: &'ast ItemEnum) {
        self.note_type(&item.ident, &item.vis);
        visit::visit_item_enum(self, item);
    }

    fn visit_item_trait(&mut self, item: &'ast ItemTrait) {
        self.note_type(&item.ident, &item.vis);
        visit::visit_item_trait(self, item);
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        if !is_test(&item.attrs) {
            self.visit_visibility(&item.vis);
            if !self.is_for_users(item) {
                self.note_use(&item.tree, &mut Vec::new());
            }
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let names: Vec<String> = path
            .segments
            .iter()
            .map(|segment| segment.ident.to_string())
            .collect();
        self.note_path(&names);
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        self.note_tokens(call.tokens.clone());
        visit::visit_macro(self, call);
    }
}

/// The rooms that reach each other both ways, of more than one room each.
pub(super) fn knots<'a>(
    rooms: &BTreeSet<&'a str>,
    uses: &BTreeMap<&'a str, BTreeSet<&'a str>>,
) -> Vec<BTreeSet<&'a str>> {
    let reached = |from: &'a str| {
        let mut seen = BTreeSet::new();
        let mut ahead = vec![from];
        while let Some(room) = ahead.pop() {
            for &next in uses.get(room).into_iter().flatten() {
                if seen.insert(next) {
                    ahead.push(next);
                }
            }
        }
        seen
    };
    let reaches: BTreeMap<&str, BTreeSet<&str>> =
        rooms.iter().map(|&room| (room, reached(room))).collect();
    let knot_of = |room: &'a str| -> BTreeSet<&'a str> {
        let there = &reaches[room];
        let both = |other: &&'a str| there.contains(other) && reaches[other].contains(room);
        rooms.iter().copied().filter(both).collect()
    };
    let knots: BTreeSet<BTreeSet<&str>> = rooms.iter().map(|&room| knot_of(room)).collect();
    knots.into_iter().filter(|knot| knot.len() > 1).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(path: &str, text: &str) -> SourceFile {
        SourceFile::read(text, Path::new(path)).expect("it parses")
    }

    #[test]
    fn lines_items_and_types_are_counted_outside_the_tests() {
        let text = "//! Two.\n\npub struct A {\n    pub(crate) b: u8,\n}\npub(super) fn c() {}\n#[cfg(test)]\nmod tests {\n    pub(super) struct A;\n}\n";
        let file = read("axis/core.rs", text);
        assert_eq!((file.code, file.comments, file.tests), (4, 1, 4));
        assert_eq!((file.restricted, file.public_types), (2, 1));
        assert!(file.types.contains("A") && file.types.len() == 1);
    }

    #[test]
    fn imports_lead_to_rooms() {
        let text = "use crate::{ds402::State, coe};\nuse super::Failure;\nuse super::super::bus::Net;\nfn f() { crate::units::of(); log!(a, crate::esi::X { y: 1 }) }\n";
        let imports = read("axis/core.rs", text).imports;
        let names: Vec<&str> = imports.iter().map(String::as_str).collect();
        assert_eq!(names, ["bus/Net", "coe", "ds402", "esi", "units"]);
    }

    #[test]
    fn the_parts_of_the_bus_are_rooms_of_their_own() {
        let text = "use super::{cycle::Cycle, Network};\nuse crate::{bus::{log, error::{A, B}}, coe::C};\n";
        let file = read("bus/watch/mod.rs", text);
        assert_eq!(file.room, "bus/watch");
        let names: Vec<&str> = file.imports.iter().map(String::as_str).collect();
        assert_eq!(
            names,
            ["bus/Network", "bus/cycle", "bus/error", "bus/log", "coe"]
        );
        assert_eq!(read("bus/mod.rs", "").room, "bus");
        assert_eq!(read("bus/cable.rs", "").room, "bus/cable");
    }

    #[test]
    fn the_sentences_of_the_documentation_are_counted() {
        let text =
            "//! One two.\n\n/// Three four five. Six\n/// seven.\n// Not this one.\nfn f() {}\n";
        assert_eq!(read("axis/core.rs", text).sentences, [2, 3, 2]);
    }

    #[test]
    fn handles_that_a_module_shows_to_users_are_no_import_of_its_room() {
        let text = "pub use crate::handle::{Axis, Move};\npub use crate::coe::Object;\n";
        let shown = read("axis/mod.rs", text).imports;
        assert_eq!(shown.iter().collect::<Vec<_>>(), ["coe"]);
        for (path, text) in [
            ("axis/mod.rs", "use crate::handle::Axis;"),
            ("axis/core/step.rs", "pub use crate::handle::Axis;"),
        ] {
            assert!(
                read(path, text).imports.contains("handle"),
                "{path}: {text}"
            );
        }
    }

    #[test]
    fn rooms_that_reach_each_other_through_others_are_one_knot() {
        let rooms = BTreeSet::from(["a", "b", "c", "d"]);
        let uses = BTreeMap::from([
            ("a", BTreeSet::from(["b"])),
            ("b", BTreeSet::from(["c", "d"])),
            ("c", BTreeSet::from(["a"])),
        ]);
        assert_eq!(knots(&rooms, &uses), [BTreeSet::from(["a", "b", "c"])]);
    }
}
