//! Whether a machine can keep cycles on time: what is in the way, and what to change.
//!
//! With an interface, or for the computer alone. Nothing is changed on it and nothing is sent on the interface.

mod checks;
mod interface;
mod latency;

use std::{error::Error, path::Path, time::Duration};

use clap::Args;
use serde_json::{Value, json};
use servocrab::{
    bus::{RealTime, Scheduling},
    link::{RawSocket, RawSocketError},
};

mod cable;

use cable::Cable;
use checks::{Finding, Verdict};

use crate::output::{Done, Interrupted, Tool, table};

/// What this computer is to do.
#[derive(Args)]
pub(crate) struct Arguments {
    /// The network interface that the line is to be on.
    #[arg(long)]
    interface: Option<String>,
    /// The cycle that is wanted, in microseconds.
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(50..=1_000_000))]
    cycle_us: u32,
    /// How many axes the line is to have, one a drive with the default mappings: shows what their frames take of the cycle.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=4096))]
    axes: Option<u16>,
    /// How long to measure the timer.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=86_400))]
    seconds: u32,
}

/// The real-time priority that is tried.
const PRIORITY: u8 = 80;

/// True if there is nothing to change.
pub(crate) fn run(tool: &Tool, arguments: &Arguments) -> Done {
    let findings = findings(tool, arguments)?;
    let healthy = findings
        .iter()
        .all(|finding| finding.verdict != Verdict::Change);
    tool.say(&json(&findings), text(&findings))?;
    Ok(healthy)
}

/// What `doctor --json` says of the computer and of this interface, with a cycle of 1000 µs and after so many seconds.
pub(crate) fn examined(
    tool: &Tool,
    interface: Option<&str>,
    seconds: u32,
) -> Result<Value, Interrupted> {
    let arguments = Arguments {
        interface: interface.map(str::to_owned),
        cycle_us: 1000,
        axes: None,
        seconds,
    };
    Ok(json(&findings(tool, &arguments)?))
}

fn findings(tool: &Tool, arguments: &Arguments) -> Result<Vec<Finding>, Interrupted> {
    let mut findings = checks::machine(Path::new("/"));
    findings.extend(permissions(arguments.interface.as_deref()));
    if let Some(name) = &arguments.interface {
        findings.extend(interface::look(Path::new("/"), name));
    }
    let cycle = Duration::from_micros(arguments.cycle_us.into());
    findings.extend(arguments.axes.map(|axes| on_the_cable(axes, cycle)));
    let time = Duration::from_secs(arguments.seconds.into());
    findings.extend(latency::measure(tool, cycle, time, PRIORITY)?);
    Ok(findings)
}

fn json(findings: &[Finding]) -> Value {
    let all = findings.iter().map(|finding| {
        json!({
            "check": finding.check,
            "verdict": finding.verdict.to_string(),
            "found": finding.found,
            "change": finding.change,
        })
    });
    all.collect()
}

fn text(findings: &[Finding]) -> String {
    let row = |finding: &Finding| {
        [
            finding.verdict.to_string(),
            finding.check.to_owned(),
            finding.found.clone(),
        ]
    };
    let rows: Vec<_> = findings.iter().map(row).collect();
    let mut text = table(["", "check", "found"], &rows);
    let changes = findings
        .iter()
        .filter_map(|finding| Some((finding.check, finding.change.as_ref()?)));
    for (place, (check, change)) in changes.enumerate() {
        if place == 0 {
            text += "\nWhat to change:\n";
        }
        text += &format!("- {check}: {change}\n");
    }
    text
}

/// Bytes of an axis with the default mappings: 19 of outputs, 11 of inputs.
const BYTES_OF_AN_AXIS: usize = 30;

/// What the frames of so many axes take of a cycle, by the formula of docs/scaling.md.
fn on_the_cable(axes: u16, cycle: Duration) -> Finding {
    let check = "cable";
    let drives = usize::from(axes);
    let cable = Cable {
        drives,
        bytes: BYTES_OF_AN_AXIS,
        clock: true,
        metres: 2 * drives,
    };
    let micros = cable.nanoseconds() as f64 / 1e3;
    let found = format!(
        "{axes} axes of {BYTES_OF_AN_AXIS} bytes, one a drive: {micros:.0} µs of a cycle of {cycle:?}"
    );
    // The bus loop waits for its frames for three quarters of a cycle.
    let shortest = micros * 4.0 / 3.0;
    if shortest <= cycle.as_nanos() as f64 / 1e3 {
        return Finding::good(check, found);
    }
    Finding::change(
        check,
        found,
        format!(
            "frames are waited for during three quarters of a cycle: choose {shortest:.0} µs at least, map less, or divide the line \
             into several networks (docs/scaling.md)"
        ),
    )
}

/// What the operating system allows this program, tried.
fn permissions(interface: Option<&str>) -> Vec<Finding> {
    // The loopback interface is there on every machine, if not always up; nothing is sent.
    let socket = match (interface, RawSocket::open(interface.unwrap_or("lo"))) {
        (_, Ok(_)) | (None, Err(RawSocketError::InterfaceDown(_))) => None,
        (_, Err(error)) => Some(error),
    };
    let scheduling = tried(RealTime::new().scheduling(Scheduling::Fifo(PRIORITY)));
    let memory = tried(RealTime::new().lock_memory());
    vec![
        Finding::of_attempt("raw socket", "may be opened", socket),
        Finding::of_attempt(
            "real-time scheduling",
            "SCHED_FIFO 80 may be used",
            scheduling.err(),
        ),
        Finding::of_attempt("locked memory", "may be locked", memory.err()),
    ]
}

/// On a thread of its own, which ends with it.
fn tried(real_time: RealTime) -> Result<(), Box<dyn Error + Send + Sync>> {
    match std::thread::spawn(move || real_time.apply()).join() {
        Ok(result) => result.map_err(Into::into),
        Err(_) => Err("the thread has panicked".into()),
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::{Verdict, on_the_cable};

    #[test]
    fn more_axes_than_a_cycle_holds_are_told_with_the_cycle_that_holds_them() {
        // By the table of docs/scaling.md: 240 µs, and 321 µs of cycle.
        let cycle = Duration::from_micros;
        assert_eq!(on_the_cable(64, cycle(322)).verdict, Verdict::Good);
        let found = on_the_cable(64, cycle(300));
        assert!(
            found.found.ends_with("240 µs of a cycle of 300µs"),
            "{}",
            found.found
        );
        assert!(found.change.unwrap().contains("choose 321 µs at least"));
    }
}
