//! Rewrites a file so that its mutants can be chosen at run time: the smallest block around a mutant's edits becomes a
//! `match` on the mutant that is on, with a copy of the block for each mutant and the block as it was for all others.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::ops::Range;

use super::source::{self, Item};
use super::table::Edit;

/// An edit in its place.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Placed {
    range: Range<usize>,
    replace: String,
    /// The smallest block around it; none outside of blocks.
    block: Option<Range<usize>>,
    /// The word `const` of the function, which such a function cannot keep.
    constant: Option<Range<usize>>,
    /// The function around it.
    item: Range<usize>,
}

/// A source file and what it consists of.
pub(crate) struct File {
    text: String,
    items: Vec<Item>,
}

/// A mutant's edits of one file.
pub(crate) struct Change<'a> {
    pub(crate) id: &'a str,
    pub(crate) number: u32,
    pub(crate) edits: Vec<Placed>,
}

/// The file with its mutants, and the lines in which each of them stands.
#[derive(Default)]
pub(crate) struct Rewritten {
    pub(crate) text: String,
    pub(crate) lines: Vec<(Range<usize>, u32)>,
}

impl File {
    pub(crate) fn read(text: String) -> syn::Result<Self> {
        Ok(Self {
            items: source::items(&text)?,
            text,
        })
    }

    /// Where an edit belongs, or why that is not clear.
    pub(crate) fn place(&self, edit: &Edit) -> Result<Placed, String> {
        let path: String = edit.function.split_whitespace().collect();
        let named: Vec<&Item> = self
            .items
            .iter()
            .filter(|item| item.path.split_whitespace().collect::<String>() == path)
            .collect();
        if named.is_empty() {
            return Err(format!("{} has no {}", edit.file, edit.function));
        }
        let mut found = named.iter().flat_map(|item| {
            let places = find(&self.text[item.range.clone()], &edit.find);
            places.into_iter().map(move |place| (item, place))
        });
        let (Some((item, place)), None) = (found.next(), found.next()) else {
            let times = named
                .iter()
                .map(|item| find(&self.text[item.range.clone()], &edit.find).len());
            return Err(format!(
                "{} of {} has {} times, not once: {}",
                edit.function,
                edit.file,
                times.sum::<usize>(),
                edit.find.trim()
            ));
        };
        let range = place.start + item.range.start..place.end + item.range.start;
        Ok(placed(item, range, edit.replace.trim()))
    }

    /// An edit of what stands from one place to another: lines and columns count from 1, columns in characters.
    pub(crate) fn place_at(
        &self,
        from: (usize, usize),
        to: (usize, usize),
        replace: &str,
    ) -> Result<Placed, String> {
        let range = self.offset(from)?..self.offset(to)?;
        let around = self.items.iter().filter(|item| {
            let mut blocks = item.blocks.iter();
            blocks.any(|block| block.start < range.start && range.end < block.end)
        });
        let item = around.min_by_key(|item| item.range.len());
        let item = item.ok_or("outside of all functions")?;
        Ok(placed(item, range, replace))
    }

    fn offset(&self, (line, column): (usize, usize)) -> Result<usize, String> {
        let missing = || format!("has no line {line} with a column {column}");
        let text = self.text.split_inclusive('\n').nth(line - 1);
        let text = text.ok_or_else(missing)?;
        let begin = text.as_ptr().addr() - self.text.as_ptr().addr();
        let mut places = text.char_indices().map(|(at, _)| at).chain([text.len()]);
        Ok(begin + places.nth(column - 1).ok_or_else(missing)?)
    }

    /// The file with one mutant in it for good.
    pub(crate) fn with(&self, edits: &[Placed]) -> String {
        let mut edits: Vec<_> = edits.iter().collect();
        edits.sort_by_key(|edit| edit.range.start);
        let mut text = String::new();
        let mut at = 0;
        for edit in edits {
            text.push_str(&self.text[at..edit.range.start]);
            text.push_str(&edit.replace);
            at = edit.range.end;
        }
        text.push_str(&self.text[at..]);
        text
    }

    /// The names of its constant functions that hold one of these mutants, or call a function of one of these names.
    pub(crate) fn no_longer_constant(
        &self,
        changes: &[Change<'_>],
        names: &BTreeSet<String>,
    ) -> BTreeSet<String> {
        let edits = || changes.iter().flat_map(|change| &change.edits);
        let constant = self.items.iter().filter(|item| item.constant.is_some());
        constant
            .filter(|item| edits().any(|edit| edit.item == item.range) || self.calls(item, names))
            .filter_map(|item| Some(item.path.rsplit("::").next()?.to_owned()))
            .collect()
    }

    /// Whether a function's body calls one of these names.
    fn calls(&self, item: &Item, names: &BTreeSet<String>) -> bool {
        let body = item
            .blocks
            .first()
            .map_or("", |body| &self.text[body.clone()]);
        body.match_indices('(').any(|(at, _)| {
            let word = |character: char| character.is_alphanumeric() || character == '_';
            let name = body[..at].rsplit(|character| !word(character)).next();
            name.is_some_and(|name| names.contains(name))
        })
    }

    /// The file with a choice among the mutants wherever there is one. A constant function that calls one of these names
    /// is none any more.
    pub(crate) fn with_choices(
        &self,
        changes: &[Change<'_>],
        names: &BTreeSet<String>,
    ) -> Result<Rewritten, String> {
        let mut choices: Vec<Choice<'_>> = Vec::new();
        let called = self.items.iter().filter(|item| self.calls(item, names));
        let mut constants: Vec<_> = called.filter_map(|item| item.constant.clone()).collect();
        for change in changes {
            for item in functions(&change.edits) {
                let edits: Vec<_> = change
                    .edits
                    .iter()
                    .filter(|edit| edit.item == item)
                    .collect();
                // The smallest block around all of them.
                let blocks = self
                    .items
                    .iter()
                    .filter(|of| of.range == item)
                    .flat_map(|of| &of.blocks);
                let around = blocks
                    .filter(|block| {
                        edits.iter().all(|edit| {
                            block.start < edit.range.start && edit.range.end < block.end
                        })
                    })
                    .min_by_key(|block| block.len());
                let Some(around) = around else {
                    return Err(
                        "outside of all blocks, where nothing can be chosen at run time".to_owned(),
                    );
                };
                constants.extend(edits[0].constant.clone());
                let copy = Copy {
                    id: change.id,
                    number: change.number,
                    edits,
                };
                match choices.iter_mut().find(|choice| choice.block == *around) {
                    Some(choice) => choice.copies.push(copy),
                    None => choices.push(Choice {
                        block: around.clone(),
                        copies: vec![copy],
                    }),
                }
            }
        }
        choices.sort_by_key(|choice| choice.block.start);
        constants.sort_by_key(|word| word.start);
        constants.dedup();
        let mut writer = Writer {
            text: &self.text,
            choices: &choices,
            constants: &constants,
            out: Rewritten::default(),
        };
        writer.write(0..self.text.len(), None);
        Ok(writer.out)
    }
}

fn placed(item: &Item, range: Range<usize>, replace: &str) -> Placed {
    let blocks = item.blocks.iter();
    Placed {
        block: blocks
            .filter(|block| block.start < range.start && range.end < block.end)
            .min_by_key(|block| block.len())
            .cloned(),
        constant: item.constant.clone(),
        item: item.range.clone(),
        replace: replace.to_owned(),
        range,
    }
}

/// The functions that these edits change.
fn functions(edits: &[Placed]) -> Vec<Range<usize>> {
    let mut functions: Vec<_> = edits.iter().map(|edit| edit.item.clone()).collect();
    functions.sort_by_key(|range| range.start);
    functions.dedup();
    functions
}

/// A block that is there several times.
struct Choice<'a> {
    /// With its braces.
    block: Range<usize>,
    copies: Vec<Copy<'a>>,
}

/// What a block is with one mutant.
struct Copy<'a> {
    id: &'a str,
    number: u32,
    edits: Vec<&'a Placed>,
}

struct Writer<'a> {
    text: &'a str,
    /// By where they begin: what is around another comes first.
    choices: &'a [Choice<'a>],
    constants: &'a [Range<usize>],
    out: Rewritten,
}

impl Writer<'_> {
    /// Writes a part of the file. `within` is the choice whose block it is.
    fn write(&mut self, part: Range<usize>, within: Option<usize>) {
        let mut at = part.start;
        let first = within.map_or(0, |choice| choice + 1);
        for (number, choice) in self.choices.iter().enumerate().skip(first) {
            if choice.block.start < at || choice.block.end > part.end {
                continue;
            }
            self.plain(at..choice.block.start);
            self.choice(number);
            at = choice.block.end;
        }
        self.plain(at..part.end);
    }

    /// Writes text of the file, but for the words that keep a function constant.
    fn plain(&mut self, part: Range<usize>) {
        let mut at = part.start;
        for word in self
            .constants
            .iter()
            .filter(|word| part.start <= word.start && word.end <= part.end)
        {
            self.out.text.push_str(&self.text[at..word.start]);
            at = word.end;
        }
        self.out.text.push_str(&self.text[at..part.end]);
    }

    fn choice(&mut self, number: usize) {
        let Choice { block, copies } = &self.choices[number];
        let numbers: Vec<u32> = copies.iter().map(|copy| copy.number).collect();
        let _ = writeln!(
            self.out.text,
            "{{ static NOTED: ::mutants::Noted = ::mutants::Noted::new(false); match ::mutants::among(&{numbers:?}, &NOTED) {{"
        );
        for copy in copies {
            let first = self.line();
            let _ = write!(
                self.out.text,
                "{} /* {} */ => {{ ::mutants::evaluated(); ",
                copy.number, copy.id
            );
            let mut edits = copy.edits.clone();
            edits.sort_by_key(|edit| edit.range.start);
            let mut at = block.start + 1;
            for edit in edits {
                self.out.text.push_str(&self.text[at..edit.range.start]);
                self.out.text.push_str(&edit.replace);
                at = edit.range.end;
            }
            self.out.text.push_str(&self.text[at..block.end]);
            self.out.lines.push((first..self.line() + 1, copy.number));
            self.out.text.push('\n');
        }
        self.out.text.push_str("_ => {");
        self.write(block.start + 1..block.end, Some(number));
        self.out.text.push_str("\n} }");
    }

    /// The number of the line that is being written, from 1.
    fn line(&self) -> usize {
        self.out.text.matches('\n').count() + 1
    }
}

/// Where `wanted` stands in `text`, in whole words, white space of any length counting as such.
fn find(text: &str, wanted: &str) -> Vec<Range<usize>> {
    let wanted: Vec<&str> = wanted.split_whitespace().collect();
    let Some(first) = wanted.first() else {
        return Vec::new();
    };
    text.match_indices(first)
        .filter_map(|(start, _)| {
            let mut end = start;
            for (number, word) in wanted.iter().enumerate() {
                let rest = &text[end..];
                let trimmed = rest.trim_start();
                if number > 0 && rest.len() == trimmed.len()
                    || number == 0 && rest.len() != trimmed.len()
                {
                    return None;
                }
                end += rest.len() - trimmed.len();
                end += trimmed.starts_with(word).then_some(word.len())?;
            }
            let whole = !joined(text, start) && !joined(text, end);
            whole.then_some(start..end)
        })
        .collect()
}

/// Whether a word goes on over this place.
fn joined(text: &str, at: usize) -> bool {
    let word = |character: char| character.is_alphanumeric() || character == '_';
    text[..at].chars().next_back().is_some_and(word) && text[at..].chars().next().is_some_and(word)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOURCE: &str = "\
struct Drive;

impl Drive {
    const fn step(&mut self, word: u16) -> bool {
        if word & 1 == 1 {
            self.start(word);
        }
        word   & 2 == 2
    }
}

impl Display for Drive {
    fn fmt(&self) {
        print(1);
    }
}

const fn calls(drive: &mut Drive) -> bool {
    drive.step(0)
}

const LIMIT: u32 = 10;
";

    fn file() -> File {
        File::read(SOURCE.to_owned()).expect("Rust")
    }

    fn edit(function: &str, find: &str, replace: &str) -> Edit {
        Edit {
            file: "drive.rs".to_owned(),
            function: function.to_owned(),
            find: find.to_owned(),
            replace: replace.to_owned(),
        }
    }

    fn change(number: u32, edits: &[Edit]) -> Change<'static> {
        let file = file();
        let edits = edits.iter().map(|edit| file.place(edit).expect("a place"));
        Change {
            id: "id",
            number,
            edits: edits.collect(),
        }
    }

    fn rewritten(changes: &[Change<'_>]) -> Rewritten {
        let rewritten = file()
            .with_choices(changes, &BTreeSet::new())
            .expect("blocks");
        syn::parse_file(&rewritten.text).expect("Rust");
        rewritten
    }

    #[test]
    fn a_mutant_copies_the_smallest_block_around_its_edits() {
        let changes = [change(
            7,
            &[edit("Drive::step", "self.start(word);", "self.stop();")],
        )];
        let text = rewritten(&changes).text;
        assert!(
            text.contains("::new(false); match ::mutants::among(&[7], &NOTED) {\n7 /* id */ =>"),
            "{text}"
        );
        assert_eq!(text.matches("self.stop();").count(), 1, "{text}");
        assert_eq!(text.matches("self.start(word);").count(), 1, "{text}");
        assert_eq!(text.matches("word   & 2 == 2").count(), 1, "{text}");
    }

    #[test]
    fn two_edits_of_one_mutant_are_in_one_copy() {
        let edits = [
            edit("Drive::step", "self.start(word);", "self.stop();"),
            edit("Drive::step", "word & 2 == 2", "true"),
        ];
        let text = rewritten(&[change(7, &edits)]).text;
        assert_eq!(text.matches("match ::mutants::among(").count(), 1, "{text}");
        let copy = text
            .split("/* id */")
            .nth(1)
            .and_then(|rest| rest.split("_ =>").next());
        let copy = copy.expect("a copy");
        assert!(
            copy.contains("self.stop();") && copy.contains("true"),
            "{copy}"
        );
        assert!(!copy.contains("& 2"), "{copy}");
    }

    #[test]
    fn a_choice_inside_another_is_only_in_what_is_without_a_mutant() {
        let inner = change(
            7,
            &[edit("Drive::step", "self.start(word);", "self.stop();")],
        );
        let outer = change(8, &[edit("Drive::step", "word & 2 == 2", "true")]);
        let text = rewritten(&[inner, outer]).text;
        assert_eq!(text.matches("match ::mutants::among(").count(), 2, "{text}");
        let (copy, original) = text.split_once("_ => {").expect("the block as it was");
        assert!(
            copy.contains("8 /* id */") && !copy.contains("7 /* id */"),
            "{copy}"
        );
        assert!(original.contains("7 /* id */"), "{original}");
    }

    #[test]
    fn an_error_in_a_copy_is_found_by_its_line() {
        let changes = [change(
            7,
            &[edit("Drive::step", "self.start(word);", "self.stop();")],
        )];
        let rewritten = rewritten(&changes);
        let line = rewritten
            .text
            .lines()
            .position(|line| line.contains("self.stop();"));
        let line = line.expect("the line") + 1;
        assert!(
            rewritten
                .lines
                .iter()
                .any(|(lines, number)| *number == 7 && lines.contains(&line))
        );
        assert!(!rewritten.lines.iter().any(|(lines, _)| lines.contains(&1)));
    }

    #[test]
    fn a_constant_function_with_a_mutant_is_none_any_more_and_neither_is_one_that_calls_it() {
        let file = file();
        let changes = [change(7, &[edit("Drive::step", "word & 2 == 2", "true")])];
        let first = file.no_longer_constant(&changes, &BTreeSet::new());
        assert_eq!(first, BTreeSet::from(["step".to_owned()]));
        let both = file.no_longer_constant(&changes, &first);
        assert!(both.contains("calls"), "{both:?}");
        let rewritten = file.with_choices(&changes, &both).expect("blocks");
        assert!(!rewritten.text.contains("const fn"), "{}", rewritten.text);
        assert!(rewritten.text.contains("const LIMIT"));
    }

    #[test]
    fn a_function_is_named_by_its_path_in_the_file() {
        let file = file();
        assert!(
            file.place(&edit("<Drive as Display>::fmt", "print(1);", ""))
                .is_ok()
        );
        let wrong = file.place(&edit("Drive::fmt", "print(1);", ""));
        assert!(wrong.is_err_and(|wrong| wrong.contains("has no Drive::fmt")));
    }

    #[test]
    fn a_place_is_named_by_lines_and_columns() {
        let text = "fn add(one: u8) -> u8 {\n    /* µ */ one + 1\n}\n";
        let file = File::read(text.to_owned()).expect("Rust");
        let placed = file.place_at((2, 17), (2, 18), "-").expect("a place");
        assert_eq!(file.with(&[placed]), text.replace('+', "-"));
        assert!(file.place_at((9, 1), (9, 2), "").is_err());
        assert!(file.place_at((1, 1), (1, 3), "").is_err());
    }

    #[test]
    fn what_is_looked_for_stands_once_in_whole_words() {
        let file = file();
        let times = |find: &str| file.place(&edit("Drive::step", find, "")).map(|_| ());
        assert_eq!(times("word & 2"), Ok(()));
        assert!(times("word").is_err_and(|wrong| wrong.contains("4 times, not once")));
        assert!(times("ord & 2").is_err_and(|wrong| wrong.contains("0 times")));
        assert!(times("self.start(word); }").is_ok());
        assert!(times("").is_err());
    }

    #[test]
    fn outside_of_blocks_there_is_no_choice_and_a_single_mutant_is_written_as_it_is() {
        let file = file();
        let limit = change(7, &[edit("LIMIT", "10", "20")]);
        let wrong = file.with_choices(std::slice::from_ref(&limit), &BTreeSet::new());
        assert!(wrong.is_err_and(|wrong| wrong.contains("outside of all blocks")));
        let text = file.with(&limit.edits);
        assert_eq!(text, SOURCE.replace("= 10", "= 20"));
    }
}
