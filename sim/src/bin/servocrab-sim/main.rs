//! A simulated EtherCAT segment on a network interface.

mod line;
mod machine;
mod trace;

use std::error::Error;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use clap::{ArgMatches, CommandFactory, FromArgMatches, Parser, ValueEnum};
use line::LineArguments;
use machine::MachineArguments;
use servocrab_sim::link::{FRAME_CAPACITY, RawSocket};
use servocrab_sim::personality::Servo;
use servocrab_sim::{
    Device, EsiChoice, EsiDrive, Faults, FaultsError, FaultyLine, Segment, personality,
};
use trace::Trace;

/// How long the program waits for a frame before it looks at the time again.
const WAIT: Duration = Duration::from_millis(1);
/// How many frames are answered before the program looks at the time and at signals again.
const BURST: usize = 64;
/// How often the trace is written out.
const FLUSH_EVERY: Duration = Duration::from_millis(100);

/// Simulates a line of EtherCAT SubDevices on a network interface.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    /// Network interface to answer on, for example one end of a veth pair
    #[arg(long)]
    interface: String,
    /// SubDevice to append to the line; give it once for each, in order with those of --esi
    #[arg(long, required_unless_present = "esi")]
    drive: Vec<Kind>,
    /// ESI file of which a device is appended to the line, in order with those of --drive: the first, or by product code and
    /// revision (such as 0x2A or 2Ah). Its axes behave as those of the plain drive
    #[arg(long, value_name = "FILE[:PRODUCT[:REVISION]]")]
    esi: Vec<EsiChoice>,
    #[command(flatten)]
    machine: MachineArguments,
    #[command(flatten)]
    line: LineArguments,
    /// Bytes of both mailboxes of each --drive; longer ones than a drive's own are not to be had
    #[arg(long, value_name = "BYTES", value_parser = clap::value_parser!(u16).range(16..))]
    mailbox_bytes: Option<u16>,
    /// Milliseconds that an EEPROM takes for one access
    #[arg(long, value_name = "MS", default_value_t = 0)]
    sii_ms: u64,
    /// Milliseconds that it takes longer for a word that is written
    #[arg(long, value_name = "MS", default_value_t = 0)]
    sii_write_ms: u64,
    /// Milliseconds that a device takes to answer a message
    #[arg(long, value_name = "MS", default_value_t = 0)]
    mailbox_ms: u64,
    /// What goes wrong, such as loss=1%,delay=200us,cut=2s@1; the documentation of servocrab_sim::Faults has the list
    #[arg(long, value_name = "FAULTS", value_parser = faults, default_value = "")]
    faults: Faults,
    /// Seed of the faults
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Axes that are exactly where they are told, in place of those with following error, overshoot and dither
    #[arg(long)]
    ideal: bool,
    /// Seconds to run; without it, until SIGINT or SIGTERM
    #[arg(long = "for", value_name = "SECONDS", value_parser = seconds)]
    duration: Option<Duration>,
    /// CSV file that gets a row for each axis and drive cycle
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
}

/// The SubDevices that can be simulated.
#[derive(Clone, Copy, ValueEnum)]
enum Kind {
    /// Kollmorgen AKD2G, two axes
    Akd2g,
    /// Stepper drive with object 2010h
    Pp2010,
    /// Beckhoff AX2000
    Ax2000,
    /// Yaskawa Sigma-7, incremental encoder
    Sigma7,
    /// Plain CiA 402 drive
    Generic,
    /// A coupler without process data
    Coupler,
    /// An I/O terminal without CoE, two bytes each way: its inputs are wired to its outputs
    Io,
}

fn main() -> ExitCode {
    let matches = Arguments::command().get_matches();
    let arguments = Arguments::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    match run(&arguments, &matches) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("servocrab-sim: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments, matches: &ArgMatches) -> Result<(), Box<dyn Error>> {
    let mut segment = Segment::new();
    let mut terminals = Vec::new();
    for one in line_order(arguments, matches) {
        if matches!(one, OnLine::Kind(Kind::Io)) {
            terminals.push(segment.len());
        }
        let mut device = match one {
            OnLine::Kind(kind) => build(kind, &arguments.machine, arguments.mailbox_bytes),
            OnLine::Esi(choice) => {
                let drive = EsiDrive::choose(choice)?;
                for warning in drive.warnings() {
                    eprintln!("{warning}");
                }
                drive
                    .change(|behaviour| behaviour.machine = arguments.machine.machine())
                    .build()
            }
        };
        device.set_sii_delay(Duration::from_millis(arguments.sii_ms));
        device.set_sii_write_delay(Duration::from_millis(arguments.sii_write_ms));
        device.set_mailbox_delay(Duration::from_millis(arguments.mailbox_ms));
        segment.push(device);
    }
    if arguments.ideal {
        segment = segment.ideal();
    }
    let mut cables = arguments.line.apply(&mut segment)?;
    let mut line = FaultyLine::new(segment, &arguments.faults.clone().seed(arguments.seed))?;
    let socket = RawSocket::open(&arguments.interface)?;
    let trace = match &arguments.trace {
        Some(path) => Some(start_trace(path, line.segment_mut())?),
        None => None,
    };
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    ctrlc::set_handler(move || stopped.store(true, Ordering::Relaxed))?;

    // In one piece: whoever waits for the first line may read no further.
    print!("{}", greeting(&arguments.interface, line.segment()));
    std::io::stdout().flush()?;

    let start = Instant::now();
    let mut first_frame = None;
    let mut flushed = Duration::ZERO;
    let mut buffer = [0; FRAME_CAPACITY];
    while !stop.load(Ordering::Relaxed) {
        let late = line.next_arrival();
        match late.map(|at| at.saturating_sub(start.elapsed())) {
            // The socket waits for whole milliseconds, a frame that is on its way back for less.
            Some(left) if left < WAIT => std::thread::sleep(left),
            _ => socket.wait(WAIT)?,
        }
        for _ in 0..BURST {
            let Some(length) = socket.receive(&mut buffer)? else {
                break;
            };
            let frame = buffer.get_mut(..length).unwrap_or(&mut []);
            let now = start.elapsed();
            let since = now.saturating_sub(*first_frame.get_or_insert(now));
            cables.at(since, line.segment_mut());
            line.send(frame, now);
            answer(&mut line, &socket, start.elapsed())?;
        }
        let now = start.elapsed();
        line.advance(now);
        if let Some(first) = first_frame {
            cables.at(now.saturating_sub(first), line.segment_mut());
        }
        for place in &terminals {
            wire_back(line.segment_mut(), *place);
        }
        answer(&mut line, &socket, now)?;
        if let Some(trace) = &trace
            && now - flushed >= FLUSH_EVERY
        {
            flushed = now;
            lock(trace).flush()?;
        }
        if arguments.duration.is_some_and(|duration| now >= duration) {
            break;
        }
    }
    if let Some(trace) = &trace {
        lock(trace).flush()?;
    }
    // Whoever started it may have stopped listening.
    let _ = std::io::stdout().write_all(farewell(&line).as_bytes());
    Ok(())
}

/// What a terminal puts out comes in again.
fn wire_back(segment: &mut Segment, place: usize) {
    if let Some(terminal) = segment.device_mut(place) {
        let outputs = terminal.outputs().to_vec();
        terminal.set_inputs(&outputs);
    }
}

/// A SubDevice as the arguments name it.
enum OnLine<'a> {
    Kind(Kind),
    Esi(&'a EsiChoice),
}

/// The SubDevices of `--drive` and `--esi` in the order of the arguments.
fn line_order<'a>(arguments: &'a Arguments, matches: &ArgMatches) -> Vec<OnLine<'a>> {
    let places = |name| matches.indices_of(name).into_iter().flatten();
    let kinds = arguments.drive.iter().map(|kind| OnLine::Kind(*kind));
    let files = arguments.esi.iter().map(OnLine::Esi);
    let kinds = places("drive").zip(kinds);
    let mut all: Vec<_> = kinds.chain(places("esi").zip(files)).collect();
    all.sort_by_key(|(place, _)| *place);
    all.into_iter().map(|(_, one)| one).collect()
}

type SharedTrace = Arc<Mutex<Trace<BufWriter<File>>>>;

fn start_trace(path: &PathBuf, segment: &mut Segment) -> Result<SharedTrace, Box<dyn Error>> {
    let file =
        File::create(path).map_err(|error| format!("cannot write {}: {error}", path.display()))?;
    let trace = Arc::new(Mutex::new(Trace::new(BufWriter::new(file))?));
    let rows = Arc::clone(&trace);
    segment.observe(move |record| lock(&rows).record(record));
    Ok(trace)
}

/// The trace is used by one thread only, so a poisoned lock protects nothing.
fn lock(trace: &SharedTrace) -> std::sync::MutexGuard<'_, Trace<BufWriter<File>>> {
    trace.lock().unwrap_or_else(PoisonError::into_inner)
}

fn build(kind: Kind, machine: &MachineArguments, mailbox_bytes: Option<u16>) -> Device {
    let servo = match kind {
        Kind::Akd2g => Servo::akd2g(),
        Kind::Pp2010 => Servo::pp2010(),
        Kind::Ax2000 => Servo::ax2000(),
        Kind::Sigma7 => Servo::sigma7(),
        Kind::Generic => Servo::generic(),
        Kind::Coupler => return personality::coupler(),
        Kind::Io => return personality::io_terminal(),
    };
    let servo = servo.change(|behaviour| behaviour.machine = machine.machine());
    match mailbox_bytes {
        Some(bytes) => servo.mailbox_bytes(bytes).build(),
        None => servo.build(),
    }
}

/// The line that says that the program listens, and one for each SubDevice: who it is, as a MainDevice will find it.
fn greeting(interface: &str, segment: &Segment) -> String {
    let mut text = format!("listening on {interface}: {} SubDevice(s)\n", segment.len());
    for (place, device) in (0..segment.len()).filter_map(|at| Some((at, segment.device(at)?))) {
        let description = device.description();
        let identity = description.identity;
        text += &format!(
            "{place}: {}, vendor {:08X}h, product {:08X}h, revision {}, serial {}, axes: {}\n",
            description.name,
            identity.vendor,
            identity.product,
            identity.revision,
            identity.serial,
            device.axes().len(),
        );
    }
    text
}

/// Sends what has come back.
fn answer(line: &mut FaultyLine, socket: &RawSocket, now: Duration) -> std::io::Result<()> {
    while let Some(frame) = line.receive(now) {
        socket.send(&frame)?;
    }
    Ok(())
}

/// A line for each SubDevice: what a MainDevice has asked of it, and one for each fault: how often it happened.
fn farewell(line: &FaultyLine) -> String {
    let accesses = line
        .segment()
        .devices()
        .iter()
        .enumerate()
        .map(|(place, device)| {
            let (sii, messages) = (device.sii_accesses(), device.messages_taken());
            format!("{place}: {sii} accesses to the SII, {messages} messages\n")
        });
    let faults = line.seen().iter();
    let faults = faults.map(|(name, times)| format!("fault {name}: {times} times\n"));
    accesses.chain(faults).collect()
}

fn faults(text: &str) -> Result<Faults, FaultsError> {
    text.parse()
}

fn seconds(text: &str) -> Result<Duration, String> {
    let seconds: f64 = text
        .parse()
        .map_err(|_| format!("{text:?} is no number of seconds"))?;
    Duration::try_from_secs_f64(seconds).map_err(|error| error.to_string())
}
