//! Sentences of a page.

use pulldown_cmark::{Event, Options, Parser, Tag, TagEnd};

/// A cell of a table with fewer words is an entry and no sentence.
const FEWEST_IN_CELL: usize = 6;

/// The number of words of each sentence of a page in Markdown. Blocks of code, headings and short cells of tables are left out; a
/// paragraph, an item of a list and a cell of a table end their sentences.
pub(super) fn sentences(markdown: &str) -> Vec<usize> {
    let mut lengths = Vec::new();
    let mut text = String::new();
    let mut in_code = false;
    let mut in_heading = false;
    for event in Parser::new_ext(markdown, Options::ENABLE_TABLES) {
        match event {
            Event::Start(Tag::CodeBlock(_)) => in_code = true,
            Event::End(TagEnd::CodeBlock) => in_code = false,
            Event::Start(Tag::Heading { .. }) => in_heading = true,
            Event::End(TagEnd::Heading(_)) => in_heading = false,
            Event::Text(_) | Event::Code(_) if in_code || in_heading => {}
            Event::Text(part) => text.push_str(&part),
            // One word, whatever stands in it.
            Event::Code(_) => text.push_str("code"),
            Event::SoftBreak | Event::HardBreak => text.push(' '),
            Event::Start(Tag::Paragraph | Tag::Item)
            | Event::End(TagEnd::Paragraph | TagEnd::Item) => {
                lengths.append(&mut count(&text));
                text.clear();
            }
            Event::End(TagEnd::TableCell) => {
                let mut cell = count(&text);
                if cell.iter().sum::<usize>() >= FEWEST_IN_CELL {
                    lengths.append(&mut cell);
                }
                text.clear();
            }
            _ => {}
        }
    }
    lengths.append(&mut count(&text));
    lengths
}

fn count(text: &str) -> Vec<usize> {
    let mut lengths = Vec::new();
    let mut length = 0;
    for word in text.split_whitespace() {
        if word.chars().any(char::is_alphanumeric) {
            length += 1;
        }
        let bare = word.trim_end_matches(['"', '\'', ')', '”', '’']);
        if bare.ends_with(['.', '!', '?']) && length > 0 {
            lengths.push(length);
            length = 0;
        }
    }
    if length > 0 {
        lengths.push(length);
    }
    lengths
}

#[cfg(test)]
mod tests {
    use super::sentences;

    #[test]
    fn sentences_end_at_stops_and_with_their_block() {
        let page = "# A title\n\nOne two three. Four\nfive `a b c`!\n\n```\nnot this\n```\n\n- six\n- seven eight\n";
        assert_eq!(sentences(page), [3, 3, 1, 2]);
    }

    #[test]
    fn numbers_with_a_point_and_cells_of_tables_are_no_ends_of_their_own() {
        assert_eq!(sentences("It is 0.8 of it."), [5]);
        let table = "| a b | c |\n|---|---|\n| d e f | It is more. It is a sentence. |\n";
        assert_eq!(sentences(table), [3, 4]);
    }
}
