//! What the library sends on the wire from power-on to PREOP, beside recordings of another master: `cargo xtask wire-diff`.
#![allow(missing_docs)]

use std::{
    collections::BTreeSet,
    fs::{self, File},
    path::{Path, PathBuf},
    process::ExitCode,
    sync::{Arc, Mutex},
    time::Duration,
};

use pcap_file::{
    pcap::PcapReader,
    pcapng::{Block, PcapNgReader},
};
use servocrab::{Network, link::Wire};
use servocrab_sim::{Segment, personality};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// The page that lists the differences, each with its reason.
const PAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/interop/WIRE.md");
/// Below it are registers, above it the mailboxes and the process data.
const MEMORY: u16 = 0x1000;
const AL_STATUS: u16 = 0x0130;
const PRE_OP: u8 = 2;
/// EtherType of EtherCAT.
const ETHERCAT: [u8; 2] = [0x88, 0xA4];
const LATENCY: Duration = Duration::from_micros(10);

/// Takes the directory with the recordings, `.pcap` and `.pcapng`.
fn main() -> ExitCode {
    let Some(recordings) = std::env::args_os().nth(1) else {
        eprintln!("wire-diff: which directory has the recordings?");
        return ExitCode::FAILURE;
    };
    match compare(Path::new(&recordings)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("wire-diff: {error}");
            ExitCode::FAILURE
        }
    }
}

fn compare(recordings: &Path) -> Result<()> {
    let ours = Session::of(&our_frames()?);
    let page = fs::read_to_string(PAGE)?;
    let mut files: Vec<PathBuf> = fs::read_dir(recordings)?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<std::io::Result<_>>()?;
    files.sort();
    let (mut compared, mut unlisted) = (0, 0);
    for file in files {
        let frames = match file.extension().and_then(|extension| extension.to_str()) {
            Some("pcapng") => frames_of_pcapng(&file)?,
            Some("pcap") => frames_of_pcap(&file)?,
            _ => continue,
        };
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        let recorded = Session::of(&frames);
        println!(
            "{name}: {} kinds of access, {} in a bring-up by the library",
            recorded.accesses.len(),
            ours.accesses.len()
        );
        compared += 1;
        for difference in recorded.differences(&ours) {
            let listed = page.contains(&format!("| `{difference}` |"));
            println!(
                "  {} {difference}",
                if listed { "listed " } else { "UNLISTED" }
            );
            unlisted += u32::from(!listed);
        }
    }
    match (compared, unlisted) {
        (0, _) => Err(format!("{} has no recording", recordings.display()).into()),
        (_, 0) => Ok(()),
        (_, unlisted) => {
            Err(format!("{unlisted} differences are not listed in tests/interop/WIRE.md").into())
        }
    }
}

/// The frames that come back to the library while it brings the simulated AKD2G into PREOP.
fn our_frames() -> Result<Vec<Vec<u8>>> {
    let frames = Arc::new(Mutex::new(Vec::new()));
    let noted = Arc::clone(&frames);
    let mut segment = Segment::new().with(personality::akd2g());
    let wire = Wire::in_virtual_time(LATENCY, move |frame: &mut [u8], now| {
        let comes_back = segment.process(frame, now);
        if let Ok(mut noted) = noted.lock() {
            noted.push(frame.to_vec());
        }
        comes_back
    });
    smol::block_on(Network::builder().link(wire).scan())?;
    let frames = frames.lock().map(|frames| frames.clone());
    frames.map_err(|_| "the wire has ended with a panic".into())
}

fn frames_of_pcapng(file: &Path) -> Result<Vec<Vec<u8>>> {
    let mut reader = PcapNgReader::new(File::open(file)?)?;
    let mut frames = Vec::new();
    while let Some(block) = reader.next_block() {
        match block? {
            Block::EnhancedPacket(packet) => frames.push(packet.data.into_owned()),
            Block::SimplePacket(packet) => frames.push(packet.data.into_owned()),
            _ => {}
        }
    }
    Ok(frames)
}

fn frames_of_pcap(file: &Path) -> Result<Vec<Vec<u8>>> {
    let mut reader = PcapReader::new(File::open(file)?)?;
    let mut frames = Vec::new();
    while let Some(packet) = reader.next_packet() {
        frames.push(packet?.data.into_owned());
    }
    Ok(frames)
}

/// A datagram that a device has taken.
struct Datagram<'a> {
    command: u8,
    register: u16,
    data: &'a [u8],
}

impl Datagram<'_> {
    /// APRD, FPRD, BRD, and what reads and writes.
    fn reads(&self) -> bool {
        matches!(self.command, 1 | 3 | 4 | 6 | 7 | 9 | 13 | 14)
    }

    /// APWR, FPWR, BWR, and what reads and writes.
    fn writes(&self) -> bool {
        matches!(self.command, 2 | 3 | 5 | 6 | 8 | 9)
    }
}

/// The datagrams of a frame (ETG.1000.4) whose working counter is not 0.
fn taken(frame: &[u8]) -> Vec<Datagram<'_>> {
    let mut found = Vec::new();
    if frame.get(12..14) != Some(&ETHERCAT) {
        return found;
    }
    let mut rest = frame.get(16..).unwrap_or_default();
    while let &[command, _, _, _, r0, r1, l0, l1, ..] = rest {
        let flags = u16::from_le_bytes([l0, l1]);
        let length = usize::from(flags & 0x07FF);
        let (Some(data), Some(counter)) = (
            rest.get(10..10 + length),
            rest.get(10 + length..12 + length),
        ) else {
            break;
        };
        if counter != [0, 0] {
            found.push(Datagram {
                command,
                register: u16::from_le_bytes([r0, r1]),
                data,
            });
        }
        if flags & 0x8000 == 0 {
            break;
        }
        rest = rest.get(12 + length..).unwrap_or_default();
    }
    found
}

/// What a master does to registers until the AL status shows PREOP. Before that there are no mailboxes.
struct Session {
    accesses: BTreeSet<String>,
    /// In the order in which they came first.
    writes: Vec<String>,
}

impl Session {
    fn of(frames: &[Vec<u8>]) -> Self {
        let mut session = Self {
            accesses: BTreeSet::new(),
            writes: Vec::new(),
        };
        for frame in frames {
            for datagram in taken(frame) {
                let is_status = datagram.register == AL_STATUS && datagram.reads();
                let state = datagram.data.first().map(|state| state & 0x1F);
                if datagram.register < MEMORY {
                    session.note(&datagram);
                }
                if is_status && state == Some(PRE_OP) {
                    return session;
                }
            }
        }
        session
    }

    fn note(&mut self, datagram: &Datagram<'_>) {
        let register = datagram.register;
        if datagram.reads() {
            self.accesses.insert(format!("read {register:04X}h"));
        }
        if datagram.writes() {
            // FMMUs and sync managers are written one by one, or several at once.
            let piece = match register {
                0x0600..=0x06FF => 16,
                0x0800..=0x087F => 8,
                _ => datagram.data.len().max(1),
            };
            for (place, data) in datagram.data.chunks(piece).enumerate() {
                let register = usize::from(register) + place * piece;
                let access = format!("write {register:04X}h{}", value_of(register, data));
                if self.accesses.insert(access.clone()) {
                    self.writes.push(access);
                }
            }
        }
    }

    /// What the other does and this one does not, and the other way round.
    fn differences(&self, ours: &Self) -> Vec<String> {
        let left_out = runs(self.accesses.difference(&ours.accesses));
        let left_out = left_out
            .into_iter()
            .map(|access| format!("recorded only: {access}"));
        let added = runs(ours.accesses.difference(&self.accesses));
        let added = added
            .into_iter()
            .map(|access| format!("library only: {access}"));
        let mut found: Vec<_> = left_out.chain(added).collect();
        let both = |of: &Self, other: &Self| -> Vec<String> {
            let writes = of.writes.iter();
            writes
                .filter(|write| other.writes.contains(write))
                .cloned()
                .collect()
        };
        let (theirs, ours) = (both(self, ours), both(ours, self));
        let moved = theirs
            .iter()
            .zip(&ours)
            .find(|(theirs, ours)| theirs != ours);
        found.extend(
            moved.map(|(theirs, ours)| format!("order: recorded {theirs}, library {ours}")),
        );
        found
    }
}

/// What is written, where it is the same on every line.
fn value_of(register: usize, data: &[u8]) -> String {
    match register {
        // Addresses of stations and words of the EEPROM are a master's own choice, and times are of the moment.
        0x0010..=0x0013 | 0x0502..=0x0511 | 0x0900..=0x09FF => String::new(),
        _ => {
            let end = data
                .iter()
                .rposition(|byte| *byte != 0)
                .map_or(1, |last| last + 1);
            let bytes: Vec<_> = data
                .iter()
                .take(end)
                .map(|byte| format!("{byte:02X}"))
                .collect();
            format!(" = {}", bytes.join(" "))
        }
    }
}

/// The accesses, where zeros in FMMUs or sync managers that follow one another are one.
fn runs<'a>(accesses: impl Iterator<Item = &'a String>) -> Vec<String> {
    let mut found: Vec<String> = Vec::new();
    let mut run: Option<(usize, usize)> = None;
    for access in accesses {
        let zeros = access
            .strip_prefix("write ")
            .and_then(|rest| rest.strip_suffix("h = 00"));
        let register = zeros.and_then(|register| usize::from_str_radix(register, 16).ok());
        let register = register.filter(|register| (0x0600..0x0880).contains(register));
        run = match (run, register) {
            (Some((first, last)), Some(register)) if matches!(register - last, 8 | 16) => {
                found.pop();
                found.push(format!("write {first:04X}h to {register:04X}h = 00"));
                Some((first, register))
            }
            (_, register) => {
                found.push(access.clone());
                register.map(|register| (register, register))
            }
        };
    }
    found
}
