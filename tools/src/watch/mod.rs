//! Signals of every cycle as CSV or JSON, as an MCAP file or as a picture: of the network that a program shows, or of the drives of a
//! line.

mod csv;
mod picture;
mod recording;

use std::{path::PathBuf, time::Duration};

use clap::Args;
use serde_json::json;
use servocrab::bus::{Capture, RecordedCycles, RecordedValues, Signal, Trigger};
use servocrab_attach::{ClientError, Watch, WatchedSignal, socket_of};
use smol::channel::{Receiver, bounded};

use csv::{Table, heading};
use picture::Picture;
use recording::Recording;

use crate::{
    axes::DrivesArguments,
    output::{Done, Failure, Tool, put},
    panel::all_drives,
};

/// From one look at the recorder to the next.
const LOOK: Duration = Duration::from_millis(50);

/// Where a program shows the network of the interface, its cycles are shown. Else the drives of the line are brought into OP here,
/// their axes disabled.
#[derive(Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    drives: DrivesArguments,
    /// Signals: x.position, x.state, x.6077h, 6077h@1, lateness
    #[arg(required = true)]
    signals: Vec<Signal>,
    /// Every nth cycle
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    every: u32,
    /// Ends after so many seconds; without it, Ctrl-C does
    #[arg(long = "for")]
    seconds: Option<u32>,
    /// Waits for this, shows the cycles around it, and ends: 'x.state == Fault', 'x.velocity > 100'
    #[arg(long)]
    trigger: Option<Trigger>,
    /// Cycles before the trigger
    #[arg(long, default_value_t = 500, requires = "trigger")]
    before: usize,
    /// Cycles after the trigger
    #[arg(long, default_value_t = 500, requires = "trigger")]
    after: usize,
    /// Write the cycles into this CSV file, in place of the output; a file that is there is replaced
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write the cycles into this MCAP file, in place of the output; a file that is there is replaced
    #[arg(long, value_name = "FILE")]
    mcap: Option<PathBuf>,
    /// Draw the signals over time into this file, in place of the output, a panel for each unit; a file that is there is replaced
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
}

/// What is watched, with the trigger's signal in its column.
struct Watched<'a> {
    arguments: &'a Arguments,
    signals: Vec<Signal>,
    capture: Option<Capture>,
    /// Whether the cycles around the trigger were shown.
    captured: bool,
    /// Columns that are shown.
    shown: usize,
    /// In place of the output.
    files: Option<Files>,
}

/// The files that the cycles go to.
struct Files {
    table: Option<Table>,
    recording: Option<Recording>,
    picture: Option<Picture>,
    cycles: u64,
    lost: u64,
}

pub(crate) async fn run(tool: &Tool, arguments: &Arguments) -> Done {
    let mut watched = Watched::of(arguments);
    let ended = async {
        tool.over(arguments.seconds).await;
        Ok(())
    };
    if let Some(interface) = arguments.drives.line.interface() {
        let (signals, every) = (watched.signals.clone(), arguments.every);
        let socket = socket_of(interface);
        match smol::unblock(move || Watch::open(&socket, &signals, every)).await {
            Ok(watch) => {
                watched.begin(tool, watch.signals())?;
                let cycles = read(watch);
                let shown = async {
                    while let Ok(read) = cycles.recv().await {
                        if watched.show(tool, read?)? {
                            break;
                        }
                    }
                    Ok(())
                };
                let shown = smol::future::or(shown, ended).await;
                return watched.end(tool, shown);
            }
            // Nobody has the interface, or who has it shows nothing: then the line itself is opened, or that is refused.
            Err(ClientError::Nobody(_)) => {}
            Err(error) => return Err(error.into()),
        }
    }
    let drives = &arguments.drives;
    let builder = drives.network(all_drives(tool, drives).await?)?;
    let start = drives.described.start(builder);
    let net = tool.unless_interrupted(start).await?;
    let shown = async {
        let mut recorder = net.recorder(watched.signals.iter().cloned())?;
        let known = recorder.signals().iter().map(|known| WatchedSignal {
            signal: known.signal.to_string(),
            unit: known.unit.clone(),
        });
        watched.begin(tool, &known.collect::<Vec<_>>())?;
        while let Some(mut read) = recorder.read() {
            let every = u64::from(arguments.every);
            read.cycles.retain(|cycle| cycle.number % every == 0);
            if watched.show(tool, read)? {
                break;
            }
            smol::Timer::after(LOOK).await;
        }
        Ok(())
    };
    let shown: Result<(), Failure> = smol::future::or(shown, ended).await;
    let left = net.shutdown().await;
    let done = watched.end(tool, shown)?;
    left?;
    Ok(done)
}

/// What a program sends, from a thread that waits for it.
fn read(mut watch: Watch) -> Receiver<Result<RecordedCycles, ClientError>> {
    let (sender, receiver) = bounded(64);
    smol::unblock(move || {
        while let Some(read) = watch.read().transpose() {
            // Nobody reads any more.
            if sender.send_blocking(read).is_err() {
                return;
            }
        }
    })
    .detach();
    receiver
}

impl<'a> Watched<'a> {
    fn of(arguments: &'a Arguments) -> Self {
        let mut signals = arguments.signals.clone();
        let shown = signals.len();
        let capture = arguments.trigger.as_ref().map(|trigger| {
            let column = signals.iter().position(|signal| *signal == trigger.signal);
            let column = column.unwrap_or_else(|| {
                signals.push(trigger.signal.clone());
                shown
            });
            Capture::new(column, trigger.condition, arguments.before, arguments.after)
        });
        Self {
            arguments,
            signals,
            capture,
            captured: false,
            shown,
            files: None,
        }
    }

    /// Creates the files, or prints the heading.
    fn begin(&mut self, tool: &Tool, signals: &[WatchedSignal]) -> Result<(), Failure> {
        // Behind them is the trigger's.
        let signals = signals.get(..self.shown).unwrap_or(signals);
        let Arguments { csv, mcap, svg, .. } = self.arguments;
        if csv.is_some() || mcap.is_some() || svg.is_some() {
            let table = csv.as_ref().map(|file| Table::create(file, signals));
            let recording = mcap.as_ref().map(|file| Recording::create(file, signals));
            let picture = svg.as_ref().map(|file| Picture::create(file, signals));
            self.files = Some(Files {
                table: table.transpose()?,
                recording: recording.transpose()?,
                picture: picture.transpose()?,
                cycles: 0,
                lost: 0,
            });
            return Ok(());
        }
        if tool.json {
            return Ok(());
        }
        Ok(put(heading(signals))?)
    }

    /// False if it has ended before its trigger.
    fn end(mut self, tool: &Tool, shown: Result<(), Failure>) -> Done {
        let files = self.files.take();
        self.complete(tool, files, shown)?;
        if self.capture.is_none() || self.captured {
            return Ok(true);
        }
        let after = self.arguments.after;
        tool.note(format_args!(
            "the watch has ended before the trigger and {after} cycles after it"
        ));
        Ok(false)
    }

    /// Completes the files, also where the watch has failed: they have the cycles until then.
    fn complete(
        &self,
        tool: &Tool,
        files: Option<Files>,
        shown: Result<(), Failure>,
    ) -> Result<(), Failure> {
        let Some(Files {
            table,
            recording,
            picture,
            cycles,
            lost,
        }) = files
        else {
            return shown;
        };
        let tabled = table.map_or(Ok(()), Table::complete);
        let recorded = recording.map_or(Ok(()), Recording::complete);
        let drawn = picture.map_or(Ok(()), Picture::complete);
        shown?;
        tabled?;
        recorded?;
        drawn?;
        let Arguments { csv, mcap, svg, .. } = self.arguments;
        let files = csv.iter().chain(mcap).chain(svg);
        let files: Vec<_> = files.map(|file| file.display().to_string()).collect();
        let text = format!("{cycles} cycles in {}\n", files.join(" and "));
        let json = json!({"cycles": cycles, "lost": lost, "files": files});
        tool.say(&json, text)?;
        Ok(())
    }

    /// Whether that was all.
    fn show(&mut self, tool: &Tool, read: RecordedCycles) -> Result<bool, Failure> {
        let read = match &mut self.capture {
            None => read,
            Some(capture) => match capture.take_in(read) {
                Some(captured) => {
                    self.captured = true;
                    captured
                }
                None => return Ok(false),
            },
        };
        if read.lost > 0 {
            tool.note(format_args!("{} cycles were lost on the way", read.lost));
        }
        match &mut self.files {
            Some(files) => files.take(&read)?,
            None => {
                let rows = read.cycles.iter().map(|cycle| self.row(tool, cycle));
                put(rows.collect::<String>())?;
            }
        }
        Ok(self.captured)
    }

    fn row(&self, tool: &Tool, cycle: &RecordedValues) -> String {
        if tool.json {
            let values: Vec<_> = cycle.values.iter().take(self.shown).collect();
            let row = json!({"cycle": cycle.number, "seconds": cycle.time.as_secs_f64(), "values": values});
            return format!("{row}\n");
        }
        csv::row(cycle, self.shown)
    }
}

impl Files {
    fn take(&mut self, read: &RecordedCycles) -> Result<(), Failure> {
        for cycle in &read.cycles {
            if let Some(table) = &mut self.table {
                table.write(cycle)?;
            }
            if let Some(recording) = &mut self.recording {
                recording.write(cycle)?;
            }
            if let Some(picture) = &mut self.picture {
                picture.take(cycle);
            }
        }
        self.cycles += read.cycles.len() as u64;
        self.lost += read.lost;
        Ok(())
    }
}
