//! Hostile clients against a moving machine: `cargo xtask hostile --minutes N`.
//!
//! They send garbage, half requests, endless headers, bodies that are too large, broken frames of WebSockets; they open hundreds of
//! sockets, and read nothing. The machine has to go on, and the server to answer once they have gone.
#![allow(missing_docs)]

use std::{
    env, fs,
    io::{Read, Write},
    net::{SocketAddr, TcpStream},
    os::unix::net::UnixStream,
    path::Path,
    process::ExitCode,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::{self, sleep},
    time::{Duration, Instant},
};

use rand::{RngCore, SeedableRng, rngs::StdRng};
use servocrab::{AxisConfig, DriveConfig, Network, Referencing, SetPoint, drives, link::Wire};
use servocrab_attach::{Attach, Attached, Grant, serve};
use servocrab_sim::{Segment, personality};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

const CLIENTS: u64 = 6;
/// How long a client of this test waits for an answer.
const WAITS: Duration = Duration::from_millis(300);
/// After the attack, until the server has to answer again: the connections that were left open have ended by then.
const RECOVERS: Duration = Duration::from_secs(70);
/// Bytes by which the process may have grown.
const GROWS: u64 = 128 << 20;

fn main() -> ExitCode {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let done = match arguments
        .iter()
        .map(String::as_str)
        .collect::<Vec<_>>()
        .as_slice()
    {
        ["--run", minutes, seed] => run(minutes, seed),
        _ => {
            println!("hostile clients are let loose by `cargo xtask hostile`");
            Ok(())
        }
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("hostile: {error}");
            ExitCode::FAILURE
        }
    }
}

/// What the clients did, and what became of it.
#[derive(Default)]
struct Counted {
    attacks: AtomicU64,
    answered: AtomicU64,
    refused: AtomicU64,
}

fn run(minutes: &str, seed: &str) -> Result<()> {
    let (minutes, seed): (f64, u64) = (minutes.parse()?, seed.parse()?);
    let time = Duration::try_from_secs_f64(60.0 * minutes)?;
    let mut segment = Segment::new().with(personality::akd2g());
    let wire = Wire::new(move |frame, now| segment.process(frame, now));
    let axis = AxisConfig::new("x").referencing(Referencing::AbsoluteEncoder);
    let drive = DriveConfig::new(drives::akd2g()).axis(axis).axis("y");
    let builder = Network::builder()
        .link(wire)
        .cycle(Duration::from_millis(2))
        .watchdog(Duration::from_secs(5))
        .drive(0, drive);
    let net = smol::block_on(builder.start())?;
    let directory = tempfile::tempdir()?;
    let attach = Attach::new("hostile")
        .directory(directory.path().join("servocrab"))
        .loopback(0)
        .grant(Grant::Parameters)
        .grant(Grant::Jog {
            axes: vec!["y".into()],
            max_velocity: 1000.0,
        });
    let attached = serve(&net, attach)?;
    let (address, token) = target(&attached)?;
    let (memory, files) = (memory()?, files()?);

    let (end, counted) = (
        Arc::new(AtomicBool::new(false)),
        Arc::new(Counted::default()),
    );
    let attackers: Vec<_> = (0..CLIENTS)
        .map(|client| {
            let (end, counted) = (Arc::clone(&end), Arc::clone(&counted));
            let (socket, token) = (attached.socket().to_owned(), token.clone());
            let mut client = Attacker::new(
                seed.wrapping_mul(CLIENTS).wrapping_add(client),
                socket,
                address,
                token,
            );
            thread::spawn(move || {
                while !end.load(Ordering::Relaxed) {
                    client.attack(&counted);
                }
            })
        })
        .collect();

    // The machine meanwhile: to and fro, each move to its end.
    let x = net.axis("x")?;
    let (started, mut moves) = (Instant::now(), 0_u64);
    let moved: Result<()> = smol::block_on(async {
        x.enable().await?;
        let lease = x.profile_position().await?;
        while started.elapsed() < time {
            let to = if moves.is_multiple_of(2) { 5_000 } else { 0 };
            let set_point = SetPoint::new()
                .velocity(50_000)
                .acceleration(500_000)
                .deceleration(500_000);
            lease.move_abs(to, set_point).await?.done().await?;
            moves += 1;
            if moves.is_multiple_of(50) {
                let attacks = counted.attacks.load(Ordering::Relaxed);
                eprint!(
                    "\r{} s: {moves} moves, {attacks} attacks",
                    started.elapsed().as_secs()
                );
            }
        }
        Ok(lease.release().await?)
    });
    eprintln!();
    end.store(true, Ordering::Relaxed);
    for attacker in attackers {
        attacker
            .join()
            .map_err(|_| "a client of this test has panicked")?;
    }
    moved?;
    let recovered = Instant::now();
    while !answers(attached.socket()) {
        if recovered.elapsed() > RECOVERS {
            return Err("the server does not answer once its attackers have gone".into());
        }
        sleep(Duration::from_millis(100));
    }
    let (recovered, grown) = (recovered.elapsed(), self::memory()?.saturating_sub(memory));
    let statistics = net.statistics();
    let load = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
    println!(
        "seed {seed}, {:.1} minutes, {CLIENTS} clients",
        started.elapsed().as_secs_f64() / 60.0
    );
    println!(
        "attacks {}, answered {}, refused or cut off {}",
        load(&counted.attacks),
        load(&counted.answered),
        load(&counted.refused)
    );
    println!("moves of the machine {moves}, none failed");
    println!(
        "cycles {}, late {}, frames lost {}",
        statistics.cycles, statistics.late_cycles, statistics.lost
    );
    println!(
        "answers again after {:.1} s; grown by {} kB; files open {} and {} before",
        recovered.as_secs_f64(),
        grown >> 10,
        self::files()?,
        files
    );
    drop(attached);
    smol::block_on(net.shutdown())?;
    if grown > GROWS {
        return Err(format!("the process has grown by {grown} bytes").into());
    }
    Ok(())
}

fn target(attached: &Attached) -> Result<(SocketAddr, String)> {
    let panel = attached
        .panel()
        .and_then(|panel| panel.strip_prefix("http://"));
    let (address, token) = panel
        .and_then(|panel| panel.split_once("/#token="))
        .ok_or("no panel")?;
    Ok((address.parse()?, token.to_owned()))
}

fn answers(socket: &Path) -> bool {
    let Ok(mut stream) = UnixStream::connect(socket) else {
        return false;
    };
    let asked = stream
        .set_read_timeout(Some(Duration::from_secs(2)))
        .and_then(|()| {
            stream
                .write_all(b"GET /v1/axes HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        });
    let mut answer = String::new();
    asked.is_ok()
        && stream.read_to_string(&mut answer).is_ok()
        && answer.starts_with("HTTP/1.1 200")
}

/// Resident bytes of this process.
fn memory() -> Result<u64> {
    let status = fs::read_to_string("/proc/self/status")?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kilobytes = line
        .and_then(|line| line.split_whitespace().next())
        .ok_or("no VmRSS")?;
    Ok(kilobytes.parse::<u64>()? << 10)
}

fn files() -> Result<usize> {
    Ok(fs::read_dir("/proc/self/fd")?.count())
}

trait Stream: Read + Write + Send {}
impl<T: Read + Write + Send> Stream for T {}

struct Attacker {
    random: StdRng,
    socket: std::path::PathBuf,
    address: SocketAddr,
    token: String,
}

impl Attacker {
    fn new(seed: u64, socket: std::path::PathBuf, address: SocketAddr, token: String) -> Self {
        Self {
            random: StdRng::seed_from_u64(seed),
            socket,
            address,
            token,
        }
    }

    fn below(&mut self, bound: u64) -> u64 {
        self.random.next_u64() % bound
    }

    fn bytes(&mut self, most: u64) -> Vec<u8> {
        let mut bytes = vec![0; self.below(most) as usize + 1];
        self.random.fill_bytes(&mut bytes);
        bytes
    }

    fn connect(&mut self) -> Option<Box<dyn Stream>> {
        if self.below(2) == 0 {
            let stream = UnixStream::connect(&self.socket).ok()?;
            stream.set_read_timeout(Some(WAITS)).ok()?;
            stream.set_write_timeout(Some(WAITS)).ok()?;
            Some(Box::new(stream))
        } else {
            let stream = TcpStream::connect_timeout(&self.address, WAITS).ok()?;
            stream.set_read_timeout(Some(WAITS)).ok()?;
            stream.set_write_timeout(Some(WAITS)).ok()?;
            Some(Box::new(stream))
        }
    }

    /// Mostly one that is let in.
    fn headers(&mut self) -> String {
        let (address, token) = (self.address, self.token.clone());
        match self.below(5) {
            0 => "Host: example.org\r\n".into(),
            1 => format!("Host: {address}\r\nAuthorization: Bearer 0\r\n"),
            _ => format!("Host: {address}\r\nAuthorization: Bearer {token}\r\n"),
        }
    }

    /// A path with something in it that may be understood.
    fn path(&mut self) -> String {
        const PARTS: [&str; 22] = [
            "/v1",
            "/axes",
            "/line",
            "/od",
            "/0",
            "/6041h",
            "/999999999999",
            "/stream?signals=",
            "x.position,",
            "%",
            "%00",
            "..",
            "/events",
            "/black_box",
            "/metrics",
            "?every=0",
            "&every=99999999999",
            "/grants",
            "/y",
            "/home",
            "/move",
            "💥",
        ];
        let number = self.below(6) + 1;
        let parts = (0..number).map(|_| PARTS[self.below(PARTS.len() as u64) as usize]);
        let path: String = parts.collect();
        if path.starts_with('/') {
            path
        } else {
            format!("/{path}")
        }
    }

    fn attack(&mut self, counted: &Counted) {
        counted.attacks.fetch_add(1, Ordering::Relaxed);
        let Some(mut stream) = self.connect() else {
            counted.refused.fetch_add(1, Ordering::Relaxed);
            return;
        };
        let kind = self.below(9);
        let done = match kind {
            0 => {
                let bytes = self.bytes(8192);
                stream.write_all(&bytes)
            }
            1 => {
                let request = format!("GET {} HTTP/1.1\r\n{}", self.path(), self.headers());
                let cut = self.below(request.len() as u64) as usize;
                let sent = stream.write_all(&request.as_bytes()[..cut]);
                sleep(Duration::from_millis(self.below(200)));
                sent
            }
            2 => (0..20_000).try_for_each(|line| write!(stream, "X-{line}: {line}\r\n")),
            3 => {
                let headers = self.headers();
                let head = format!(
                    "POST /v1/od/0/6066h/0 HTTP/1.1\r\n{headers}Content-Length: 9000000\r\n\r\n"
                );
                let sent = stream.write_all(head.as_bytes());
                sent.and_then(|()| (0..100).try_for_each(|_| stream.write_all(&[b'['; 4096])))
            }
            4 => {
                // Many at once; each ends as it began.
                let many: Vec<_> = (0..100).map(|_| self.connect()).collect();
                sleep(Duration::from_millis(self.below(100)));
                drop(many);
                Ok(())
            }
            5 | 6 => {
                let path = if kind == 5 {
                    "/v1/control"
                } else {
                    "/v1/stream?signals=x.position,lateness"
                };
                let upgrade = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
                let request = format!("GET {path} HTTP/1.1\r\n{}{upgrade}\r\n", self.headers());
                let sent = stream.write_all(request.as_bytes());
                sent.and_then(|()| {
                    (0..self.below(50)).try_for_each(|_| match self.below(3) {
                        0 => {
                            let bytes = self.bytes(300);
                            stream.write_all(&bytes)
                        }
                        1 => frame(&mut *stream, br#"{"hold":{"axis":"y","velocity":1e308,"tick":18446744073709551615}}"#),
                        _ => frame(&mut *stream, b"[[[[[[[[[[[[[[{\"release\":"),
                    })
                })
            }
            7 => {
                let request = format!("GET {} HTTP/1.1\r\n{}\r\n", self.path(), self.headers());
                (0..40).try_for_each(|_| stream.write_all(request.as_bytes()))
            }
            _ => {
                let request = format!(
                    "GET {} HTTP/1.1\r\n{}Connection: close\r\n\r\n",
                    self.path(),
                    self.headers()
                );
                stream.write_all(request.as_bytes())
            }
        };
        // Some never read.
        let mut answer = [0; 4096];
        let is_answered = done.is_ok()
            && self.below(4) > 0
            && stream.read(&mut answer).is_ok_and(|length| length > 0);
        let counter = if is_answered {
            &counted.answered
        } else {
            &counted.refused
        };
        counter.fetch_add(1, Ordering::Relaxed);
    }
}

/// A masked text frame of a WebSocket.
fn frame(stream: &mut dyn Stream, text: &[u8]) -> std::io::Result<()> {
    let mut bytes = vec![0x81, 0x80 | text.len() as u8, 1, 2, 3, 4];
    bytes.extend(
        text.iter()
            .zip([1, 2, 3, 4].into_iter().cycle())
            .map(|(byte, mask)| byte ^ mask),
    );
    stream.write_all(&bytes)
}
