//! What clients of the server cost the cycles: lateness of the bus thread without clients, with one and ten that read a stream of 64 axes
//! at 1 kHz, and with one that never reads. All in one run, in turns. And the instructions of a cycle with the same clients, counted by
//! callgrind.
//!
//! It ends with an error where the median of the ratios of the 99.9 % quantiles is above 1.1, a client that reads has lost a cycle, or
//! a cycle takes more than 200 instructions more than without clients.
#![allow(missing_docs)]

#[path = "../../../benches/step/callgrind.rs"]
#[allow(
    dead_code,
    reason = "the whole profile is printed by the bench of the cycles"
)]
mod callgrind;
#[path = "../../../benches/common/counted.rs"]
mod counted;
mod cycles;

use std::{
    env,
    io::Write,
    os::unix::net::UnixStream,
    path::Path,
    process::ExitCode,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::{self, sleep},
    time::Duration,
};

use servocrab::{
    DriveConfig, Network,
    bus::{NetworkBuilder, RealTime, Scheduling, Signal},
    drives,
    link::Wire,
};
use servocrab_attach::{Attach, Watch, serve};
use servocrab_sim::{Segment, personality};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

const DRIVES: u16 = 32;
const ROUNDS: usize = 20;
/// So long that the 99.9 % quantile is that of the six worst cycles, not of the two.
const TURN: Duration = Duration::from_secs(6);
/// Clients have begun by then.
const SETTLING: Duration = Duration::from_millis(500);
const BOUND: f64 = 1.1;
/// Of a cycle, than without clients.
const MORE_INSTRUCTIONS: f64 = 200.0;

/// The clients of a turn.
#[derive(Clone, Copy, PartialEq)]
enum Clients {
    Reading(usize),
    /// One that asks for a stream and takes nothing of it.
    Stalled,
}

const TURNS: [(&str, Clients); 4] = [
    ("no client", Clients::Reading(0)),
    ("1 client", Clients::Reading(1)),
    ("10 clients", Clients::Reading(10)),
    ("1 that never reads", Clients::Stalled),
];

fn main() -> ExitCode {
    let is_counted = env::args()
        .nth(1)
        .is_some_and(|argument| argument == "cycles");
    let is_met = if is_counted {
        cycles::live().map(|()| true)
    } else {
        run()
    };
    match is_met {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("attach: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<bool> {
    let are_few = instructions()?;
    let is_met = lateness()?;
    Ok(are_few && is_met)
}

/// How many instructions the cycles take. Whether clients cost few.
fn instructions() -> Result<bool> {
    if !callgrind::is_there() {
        println!("instructions: NOT MEASURED: there is no valgrind (apt-get install valgrind)");
        return Ok(env::var_os("CI").is_none());
    }
    let program = env::current_exe()?;
    let target = program.ancestors().nth(3).unwrap_or(Path::new("target"));
    let dumps = callgrind::run(&target.join("bench/attach"), &["cycles"]);
    let counted: Vec<_> = dumps
        .iter()
        .map(|dump| dump.between("servocrab::bus::cycle::Cycle::", "Outside"))
        .map(|counted| counted as f64 / cycles::COUNTED as f64)
        .collect();
    println!("instructions of a cycle of {} axes", 2 * DRIVES);
    for ((name, _), counted) in TURNS.into_iter().zip(&counted) {
        println!("{name:<20} {counted:>10.1}");
    }
    let without = counted.first().copied().unwrap_or(f64::NAN);
    let are_few = counted.len() == TURNS.len()
        && counted
            .iter()
            .all(|with| with - without <= MORE_INSTRUCTIONS);
    if !are_few {
        println!("not met: at most {MORE_INSTRUCTIONS} more than without clients");
    }
    Ok(are_few)
}

/// All drives of the line, each with two axes.
fn line() -> (Segment, NetworkBuilder) {
    let segment = (0..DRIVES).fold(Segment::new(), |segment, _| {
        segment.with(personality::akd2g())
    });
    let mut builder = Network::builder();
    for position in 0..DRIVES {
        let drive = DriveConfig::new(drives::akd2g());
        let drive = drive
            .axis(format!("{position}-1"))
            .axis(format!("{position}-2"));
        builder = builder.drive(position, drive);
    }
    (segment, builder)
}

/// The position of each axis.
fn signals() -> Result<Vec<Signal>> {
    let names = (0..DRIVES).flat_map(|drive| [1, 2].map(|axis| format!("{drive}-{axis}.position")));
    Ok(names
        .map(|name| name.parse())
        .collect::<std::result::Result<_, _>>()?)
}

fn lateness() -> Result<bool> {
    let (mut segment, builder) = line();
    let wire = Wire::new(move |frame, now| segment.process(frame, now));
    let builder = builder
        .link(wire)
        .cycle(Duration::from_millis(1))
        .watchdog(Duration::from_secs(5))
        // Ahead of the clients, as on a machine; without the right to it the bench says so.
        .real_time(RealTime::new().scheduling(Scheduling::Fifo(50)));
    let net = smol::block_on(builder.start())?;
    let directory = tempfile::tempdir()?;
    let attach = Attach::new("bench").directory(directory.path().join("servocrab"));
    let attached = serve(&net, attach)?;
    let signals = signals()?;

    let mut worst: [Vec<Duration>; TURNS.len()] = Default::default();
    let mut lost = 0;
    for round in 0..ROUNDS {
        eprint!("\rround {} of {ROUNDS}", round + 1);
        // None is always the one after another.
        for turn in 0..TURNS.len() {
            let place = (round + turn) % TURNS.len();
            let (_, clients) = TURNS[place];
            let running = Running::start(attached.socket(), &signals, clients)?;
            sleep(SETTLING);
            let before = net.timing();
            sleep(TURN);
            let late = net.timing().lateness.since(&before.lateness);
            worst[place].extend(late.quantile(0.999));
            lost += running.end();
        }
    }
    eprintln!();
    let mut is_met = lost == 0;
    println!(
        "lateness of {} axes at 1 kHz, {ROUNDS} rounds in turns",
        2 * DRIVES
    );
    println!("{:<20} {:>10} {:>22}", "", "99.9 %", "ratio to no client");
    for (place, (name, _)) in TURNS.into_iter().enumerate() {
        let pairs = worst[place].iter().zip(&worst[0]);
        let ratio = median(pairs.map(|(with, without)| with.as_secs_f64() / without.as_secs_f64()));
        let late = median(worst[place].iter().map(Duration::as_secs_f64)) * 1e6;
        println!("{name:<20} {late:>7.1} µs {ratio:>22.2}");
        is_met &= ratio <= BOUND;
    }
    println!("cycles lost by clients that read: {lost}");
    drop(attached);
    smol::block_on(net.shutdown())?;
    if !is_met {
        println!("not met: at most {BOUND} of the lateness without clients, and nothing lost");
    }
    Ok(is_met)
}

/// Clients for the time of a turn.
struct Running {
    end: Arc<AtomicBool>,
    lost: Arc<AtomicU64>,
    threads: Vec<thread::JoinHandle<()>>,
    stalled: Option<UnixStream>,
}

impl Running {
    fn start(socket: &Path, signals: &[Signal], clients: Clients) -> Result<Self> {
        let mut running = Self {
            end: Arc::default(),
            lost: Arc::default(),
            threads: Vec::new(),
            stalled: None,
        };
        let number = match clients {
            Clients::Reading(number) => number,
            Clients::Stalled => {
                let names: Vec<_> = signals.iter().map(ToString::to_string).collect();
                let mut stream = UnixStream::connect(socket)?;
                write!(
                    stream,
                    "GET /v1/stream?signals={} HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
                     Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n",
                    names.join(",")
                )?;
                running.stalled = Some(stream);
                0
            }
        };
        for _ in 0..number {
            let mut watch = Watch::open(socket, signals, 1)?;
            let (end, lost) = (Arc::clone(&running.end), Arc::clone(&running.lost));
            running.threads.push(thread::spawn(move || {
                while !end.load(Ordering::Relaxed) {
                    let Ok(Some(read)) = watch.read() else {
                        // It has lost all that comes.
                        lost.fetch_add(1, Ordering::Relaxed);
                        return;
                    };
                    lost.fetch_add(read.lost, Ordering::Relaxed);
                }
            }));
        }
        Ok(running)
    }

    /// How many cycles were lost.
    fn end(self) -> u64 {
        self.end.store(true, Ordering::Relaxed);
        for thread in self.threads {
            // A client that has failed has lost what it did not read.
            if thread.join().is_err() {
                self.lost.fetch_add(1, Ordering::Relaxed);
            }
        }
        drop(self.stalled);
        self.lost.load(Ordering::Relaxed)
    }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}
