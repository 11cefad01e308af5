//! What all commands share: how they report, ask, end, and are interrupted.

use std::{
    error::Error,
    fmt::{Display, Write as _},
    io::{self, ErrorKind, IsTerminal, Write},
    process::ExitCode,
    time::Duration,
};

use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};
use smol::channel::{Receiver, bounded};

/// Why a command failed.
pub(crate) type Failure = Box<dyn Error>;

/// What a command ends with: whether all is as it should be.
pub(crate) type Done = Result<bool, Failure>;

/// How to report, and whether somebody has pressed Ctrl-C.
pub(crate) struct Tool {
    pub(crate) json: bool,
    /// Closed by Ctrl-C or SIGTERM.
    interrupt: Receiver<()>,
}

/// Somebody pressed Ctrl-C, or sent SIGTERM.
#[derive(Debug, thiserror::Error)]
#[error("interrupted")]
pub(crate) struct Interrupted;

impl Tool {
    /// From here on Ctrl-C is heard.
    pub(crate) fn new(json: bool) -> Result<Self, Failure> {
        let (sender, interrupt) = bounded(1);
        ctrlc::set_handler(move || {
            sender.close();
        })?;
        Ok(Self { json, interrupt })
    }

    /// The work's result, unless Ctrl-C comes first: then the work is dropped, which ends what it has begun on a line.
    pub(crate) async fn unless_interrupted<T>(
        &self,
        work: impl Future<Output = Result<T, Failure>>,
    ) -> Result<T, Failure> {
        smol::future::or(work, async {
            self.interrupted().await;
            Err(Interrupted.into())
        })
        .await
    }

    /// Waits for Ctrl-C.
    pub(crate) async fn interrupted(&self) {
        // Nothing is ever sent.
        let _ = self.interrupt.recv().await;
    }

    /// Waits for so many seconds, or for Ctrl-C: without a number for that alone.
    pub(crate) async fn over(&self, seconds: Option<u32>) {
        let time = async {
            let time = seconds.map(|seconds| Duration::from_secs(seconds.into()));
            time.map_or_else(smol::Timer::never, smol::Timer::after)
                .await;
        };
        smol::future::or(time, self.interrupted()).await;
    }

    /// Closed by Ctrl-C, for other threads.
    pub(crate) fn interrupt(&self) -> Receiver<()> {
        self.interrupt.clone()
    }

    pub(crate) fn is_interrupted(&self) -> bool {
        self.interrupt.is_closed()
    }

    /// The result: JSON for programs, or text.
    pub(crate) fn say(&self, json: &Value, text: impl Display) -> io::Result<()> {
        match self.json {
            true => put(format_args!("{json:#}\n")),
            false => put(text),
        }
    }

    /// Something beside the result, on the error output.
    pub(crate) fn note(&self, text: impl Display) {
        // Where nobody reads it there is nothing to be done.
        let _ = match self.json {
            true => writeln!(io::stderr(), "{}", json!({"note": text.to_string()})),
            false => writeln!(io::stderr(), "servocrab: {}", shown(&text.to_string())),
        };
    }

    /// Whether to go on. Without `--yes` the question is put to the terminal; where there is none, that is an error.
    pub(crate) async fn agreed(&self, yes: bool, question: &str) -> Result<(), Failure> {
        self.asked(yes, question, "say --yes to do it").await
    }

    /// As [`Tool::agreed`], of a command that has `--dry-run` too.
    pub(crate) async fn agreed_or_shown(&self, yes: bool, question: &str) -> Result<(), Failure> {
        let options = "say --yes to do it, or --dry-run to see what would be done";
        self.asked(yes, question, options).await
    }

    async fn asked(&self, yes: bool, question: &str, options: &str) -> Result<(), Failure> {
        if yes {
            return Ok(());
        }
        if self.json || !io::stdin().is_terminal() {
            return Err(format!("{question} There is no terminal to answer at: {options}").into());
        }
        write!(io::stderr(), "{question} [y/N] ")?;
        // On a thread of its own, so that Ctrl-C is heard meanwhile.
        let asked = smol::unblock(|| {
            let mut answer = String::new();
            io::stdin().read_line(&mut answer).map(|_| answer)
        });
        let answer = self.unless_interrupted(async { Ok(asked.await?) }).await?;
        match answer.trim() {
            "y" | "Y" | "yes" => Ok(()),
            _ => Err("nothing was done: the answer was not yes".into()),
        }
    }
}

/// Writes to the standard output; that its reader has gone away is an error and no panic.
pub(crate) fn put(text: impl Display) -> io::Result<()> {
    let mut output = io::stdout().lock();
    output.write_all(shown(&text.to_string()).as_bytes())?;
    output.flush()
}

/// A name from the wire or a file as a part of a line: what a terminal would obey, or would take for another line, is shown by its number.
pub(crate) fn plain(text: &str) -> String {
    escaped(text, |char| !char.is_control())
}

/// Whole lines, in the same way.
fn shown(text: &str) -> String {
    escaped(text, |char| char == '\n' || !char.is_control())
}

fn escaped(text: &str, is_shown: impl Fn(char) -> bool) -> String {
    // These turn the direction of what follows.
    let turns = |char| matches!(char, '\u{202A}'..='\u{202E}' | '\u{2066}'..='\u{2069}');
    let mut plain = String::with_capacity(text.len());
    for char in text.chars() {
        if is_shown(char) && !turns(char) {
            plain.push(char);
        } else {
            // As JSON writes it: what is said as JSON stays that.
            let _ = write!(plain, "\\u{:04x}", u32::from(char));
        }
    }
    plain
}

/// Rows under a heading, each column as wide as its widest cell, and at most 200 characters: formatting takes no width above 16 bits.
pub(crate) fn table<const N: usize>(heading: [&str; N], rows: &[[String; N]]) -> String {
    let heading = heading.map(String::from);
    let rows: Vec<[String; N]> = rows
        .iter()
        .map(|row| row.each_ref().map(|cell| plain(cell)))
        .collect();
    let all = || [&heading].into_iter().chain(&rows);
    let widths: [usize; N] = std::array::from_fn(|column| {
        let cells = all().map(|row| row[column].chars().count());
        cells.max().unwrap_or(0).min(200)
    });
    let mut text = String::new();
    for row in all() {
        let mut line = String::new();
        for (cell, width) in row.iter().zip(widths) {
            let _ = write!(line, "{cell:width$}  ");
        }
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}

/// A bar on the terminal's error output; none where that is a file.
pub(crate) fn bar(what: &'static str) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg} {bar:40} {pos}/{len}");
    let bar = ProgressBar::new(0).with_message(what);
    match style {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}

/// Moves the bar: so many done, of so many.
pub(crate) fn told(bar: &ProgressBar) -> impl FnMut(usize, usize) {
    |done, of| {
        bar.set_length(of as u64);
        bar.set_position(done as u64);
    }
}

/// The exit code; an error is told on the error output.
pub(crate) fn end(done: Done, json: bool) -> ExitCode {
    let error = match done {
        Ok(true) => return ExitCode::SUCCESS,
        Ok(false) => return ExitCode::from(1),
        Err(error) => error,
    };
    // Whoever read the output has seen enough.
    if let Some(error) = error.downcast_ref::<io::Error>()
        && error.kind() == ErrorKind::BrokenPipe
    {
        return ExitCode::SUCCESS;
    }
    failed(&error.to_string(), json)
}

fn failed(message: &str, json: bool) -> ExitCode {
    let _ = match json {
        true => writeln!(io::stderr(), "{}", json!({"error": message})),
        false => writeln!(io::stderr(), "servocrab: {}", shown(message)),
    };
    ExitCode::from(2)
}

/// Arguments that cannot be used, or a page of help.
pub(crate) fn usage(error: &clap::Error, json: bool) -> ExitCode {
    if json && error.use_stderr() {
        let text = error.to_string();
        let text = text.strip_prefix("error: ").unwrap_or(&text);
        return failed(text.trim_end(), true);
    }
    // Where nobody reads it there is nothing to be done.
    let _ = error.print();
    ExitCode::from(if error.use_stderr() { 2 } else { 0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_moves_no_cursor_and_makes_no_row() {
        let name = "x\u{1b}[2J\r\n1  forged\u{202E}\u{9b}2J".to_owned();
        let text = table(["name"], &[[name.clone()]]);
        let row = "x\\u001b[2J\\u000d\\u000a1  forged\\u202e\\u009b2J";
        assert_eq!(text, format!("name\n{row}\n"));
        assert_eq!(shown("a\nb\u{1b}"), "a\nb\\u001b");
        let json = json!({ "name": name });
        let said = shown(&format!("{json:#}"));
        assert_eq!(serde_json::from_str::<Value>(&said).unwrap(), json);
        assert!(said.is_ascii(), "{said}");
    }

    #[test]
    fn a_table_shows_a_cell_that_is_longer_than_formatting_takes() {
        let long = "x".repeat(70_000);
        let text = table(
            ["name", "is"],
            &[
                [long.clone(), "b".to_owned()],
                ["a".to_owned(), "b".to_owned()],
            ],
        );
        let rows: Vec<&str> = text.lines().collect();
        assert_eq!(rows[1], format!("{long}  b"));
        assert_eq!(rows[2], format!("a{}  b", " ".repeat(199)));
    }
}
