//! The line that an example looks at, and tables.

use std::fmt::Write;

use clap::Args;
use servocrab::{
    bus::{Line, Network, NetworkError},
    link::Wire,
};
use servocrab_sim::{Segment, personality};

/// Which line, and how to report on it.
#[derive(Args)]
pub(crate) struct LineArguments {
    /// The network interface that the line is on; without it, a simulated line.
    #[arg(long, global = true)]
    interface: Option<String>,
    /// Print JSON in place of a table.
    #[arg(long, global = true)]
    pub(crate) json: bool,
}

impl LineArguments {
    /// The line, in PREOP.
    pub(crate) async fn scan(&self) -> Result<Line, NetworkError> {
        let builder = Network::builder();
        match &self.interface {
            Some(interface) => builder.interface(interface).scan().await,
            None => builder.link(simulated()).scan().await,
        }
    }
}

/// A coupler, drives of three makes, and a terminal.
fn simulated() -> Wire {
    let mut segment = Segment::new()
        .with(personality::coupler())
        .with(personality::generic())
        .with(personality::akd2g())
        .with(personality::io_terminal())
        .with(personality::sigma7());
    Wire::new(move |frame, now| segment.process(frame, now))
}

/// Writes to the standard output; that its reader has gone away is an error and no panic.
pub(crate) fn put(text: impl std::fmt::Display) -> std::io::Result<()> {
    let mut output = std::io::stdout().lock();
    std::io::Write::write_fmt(&mut output, format_args!("{text}"))
}

/// Rows under a heading, each column as wide as its widest cell.
pub(crate) fn table<const N: usize>(heading: [&str; N], rows: &[[String; N]]) -> String {
    let heading = heading.map(String::from);
    let all = || [&heading].into_iter().chain(rows);
    let widths: [usize; N] = std::array::from_fn(|column| {
        let cells = all().map(|row| row[column].chars().count());
        cells.max().unwrap_or(0)
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
