//! Signals of every cycle as CSV or JSON: of the network that a program shows, or of the drives of a line.

use std::{io, time::Duration};

use clap::Args;
use serde_json::json;
use servocrab::bus::{Capture, RecordedCycles, RecordedValues, Signal, Trigger};
use servocrab_attach::{ClientError, Watch, socket_of};
use smol::channel::{Receiver, bounded};

use crate::{
    line::LineArguments,
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
    line: LineArguments,
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
    /// Time from one cycle to the next, in microseconds, where the line is brought up here
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(100..=20_000))]
    cycle_us: u32,
}

/// What is watched, with the trigger's signal in its column.
struct Watched {
    signals: Vec<Signal>,
    capture: Option<Capture>,
    /// Columns that are shown.
    shown: usize,
}

pub(crate) async fn run(tool: &Tool, arguments: &Arguments) -> Done {
    let mut watched = Watched::of(arguments);
    let time = arguments
        .seconds
        .map(|seconds| Duration::from_secs(seconds.into()));
    let ended = async {
        let over = async {
            match time {
                Some(time) => drop(smol::Timer::after(time).await),
                None => std::future::pending().await,
            }
        };
        smol::future::or(over, tool.interrupted()).await;
        Ok(())
    };
    if let Some(interface) = arguments.line.interface() {
        let (signals, every) = (watched.signals.clone(), arguments.every);
        let socket = socket_of(interface);
        match smol::unblock(move || Watch::open(&socket, &signals, every)).await {
            Ok(watch) => {
                let names = watch.signals().iter();
                let names = names.map(|known| (known.signal.clone(), known.unit.clone()));
                watched.heading(tool, names)?;
                let cycles = read(watch);
                let shown = async {
                    while let Ok(read) = cycles.recv().await {
                        if watched.show(tool, read?)? {
                            break;
                        }
                    }
                    Ok(())
                };
                return smol::future::or(shown, ended).await.map(|()| true);
            }
            // Nobody has the interface, or who has it shows nothing: then the line itself is opened, or that is refused.
            Err(ClientError::Nobody(_)) => {}
            Err(error) => return Err(error.into()),
        }
    }
    let cycle = Duration::from_micros(arguments.cycle_us.into());
    let (builder, _) = all_drives(tool, &arguments.line, cycle).await?;
    let start = async { Ok(builder.start().await?) };
    let net = tool.unless_interrupted(start).await?;
    let shown = async {
        let mut recorder = net.recorder(watched.signals.iter().cloned())?;
        let names = recorder.signals().iter();
        let names = names.map(|known| (known.signal.to_string(), known.unit.clone()));
        watched.heading(tool, names)?;
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
    shown?;
    left?;
    Ok(true)
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

impl Watched {
    fn of(arguments: &Arguments) -> Self {
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
            signals,
            capture,
            shown,
        }
    }

    fn heading(
        &self,
        tool: &Tool,
        names: impl Iterator<Item = (String, String)>,
    ) -> io::Result<()> {
        if tool.json {
            return Ok(());
        }
        let names = names
            .take(self.shown)
            .map(|(name, unit)| match unit.as_str() {
                "" => format!(",{name}"),
                unit => format!(",{name} [{unit}]"),
            });
        put(format_args!(
            "cycle,time [s]{}\n",
            names.collect::<String>()
        ))
    }

    /// Whether that was all.
    fn show(&mut self, tool: &Tool, read: RecordedCycles) -> Result<bool, Failure> {
        let read = match &mut self.capture {
            None => read,
            Some(capture) => match capture.take_in(read) {
                Some(captured) => captured,
                None => return Ok(false),
            },
        };
        if read.lost > 0 {
            tool.note(format_args!("{} cycles were lost on the way", read.lost));
        }
        let rows = read.cycles.iter().map(|cycle| self.row(tool, cycle));
        put(rows.collect::<String>())?;
        Ok(self.capture.is_some())
    }

    fn row(&self, tool: &Tool, cycle: &RecordedValues) -> String {
        let values = cycle.values.iter().take(self.shown);
        if tool.json {
            let values: Vec<_> = values.collect();
            let row = json!({"cycle": cycle.number, "seconds": cycle.time.as_secs_f64(), "values": values});
            return format!("{row}\n");
        }
        let values =
            values.map(|value| value.map_or_else(|| ",".into(), |value| format!(",{value}")));
        let values: String = values.collect();
        format!("{},{:.6}{values}\n", cycle.number, cycle.time.as_secs_f64())
    }
}
