//! Cold start to OP of a line of two-axis drives on a veth pair: this library, stock ethercrab and SOEM side by side. Of this library
//! it shows the first enabled axis as well, by when all that motion needs has been read.
//!
//! `cargo bench --bench bring_up` prints a table and writes `target/bench/bring_up.json`. It exits with 1 where this library's median
//! to OP is above SOEM's. Every start has a simulated line
//! that was just switched on. Times are of this machine and this run; what counts is how they compare. Behind each time
//! stands what the simulated drives counted: accesses to the SII (of eight bytes at most) and messages, of the drive that had
//! most.

mod masters;
#[path = "../../tests/common/namespace.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod namespace;
#[path = "../../tests/interop/programs.rs"]
#[allow(dead_code, reason = "the interop tests use more of it")]
mod programs;
#[path = "../../tests/common/python.rs"]
mod python;
#[path = "../common/stock_set_up.rs"]
mod stock_set_up;

use std::{
    env, fs,
    io::{Read as _, Write as _},
    path::{Path, PathBuf},
    process::{Command, exit},
    time::{Duration, Instant},
};

use namespace::{INSIDE, Process, run};

const OURS: &str = "servocrab";
const OURS_TO_ENABLE: &str = "servocrab-to-enable";
const SOEM: &str = "pysoem";
const MASTERS: [&str; 4] = [OURS, OURS_TO_ENABLE, "ethercrab-stock", SOEM];
const DRIVES: [usize; 5] = [1, 4, 8, 16, 32];
/// What one access to the EEPROM and one message take, in milliseconds.
const DELAYS: [(u32, u32); 2] = [(0, 0), (1, 2)];
/// Starts of each master in each row, taken in turns. Fewer, but at least three, where they take very long.
const ROUNDS: usize = 5;
const LONG: Duration = Duration::from_secs(20);
/// After this the simulated line ends by itself.
const LONGEST: u32 = 300;

fn main() {
    let arguments: Vec<String> = env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["start", master, drives] => {
            let drives = drives.parse().expect("a number of drives");
            let took = match master {
                OURS => masters::servocrab_to_op("master0", drives),
                OURS_TO_ENABLE => masters::servocrab_to_enable("master0", drives),
                _ => masters::ethercrab("master0", drives),
            };
            println!("{}", took.as_secs_f64() * 1e3);
        }
        _ if env::var_os(INSIDE).is_some() => measure(),
        _ => outside(),
    }
}

/// Makes the programs, and runs this one again inside a network namespace.
fn outside() {
    programs::simulator();
    if programs::python().is_none() {
        return;
    }
    // It ends with this process, however that ends.
    let status = Command::new("setpriv")
        .args(["--pdeathsig", "KILL", "unshare", "-rn"])
        .arg(env::current_exe().expect("this program has a path"))
        .env(INSIDE, "1")
        .status()
        .expect("unshare is there");
    exit(status.code().unwrap_or(1));
}

/// One line of the result.
struct Row {
    master: &'static str,
    drives: usize,
    sii_ms: u32,
    mailbox_ms: u32,
    /// Milliseconds, in order.
    times: Vec<f64>,
}

impl Row {
    fn median(&self) -> f64 {
        let middle = self.times.len() / 2;
        if self.times.len() % 2 == 1 {
            self.times[middle]
        } else {
            f64::midpoint(self.times[middle - 1], self.times[middle])
        }
    }

    fn json(&self) -> String {
        format!(
            "{{\"master\":\"{}\",\"drives\":{},\"sii_ms\":{},\"mailbox_ms\":{},\"median_ms\":{:.3},\"min_ms\":{:.3},\"max_ms\":{:.3}}}",
            self.master,
            self.drives,
            self.sii_ms,
            self.mailbox_ms,
            self.median(),
            self.times[0],
            self.times[self.times.len() - 1],
        )
    }
}

fn measure() {
    run(
        "ip",
        &[
            "link", "add", "master0", "type", "veth", "peer", "name", "slave0",
        ],
    );
    for interface in ["master0", "slave0"] {
        run("ip", &["link", "set", interface, "up"]);
    }
    println!(
        "milliseconds from power-on to OP, and of this library to the first enabled axis: median (least to most) of up to {ROUNDS} starts, taken in turns; accesses to \
         the SII and messages of one drive\n"
    );
    let mut rows: Vec<Row> = Vec::new();
    for (sii_ms, mailbox_ms) in DELAYS {
        println!("an access to the EEPROM takes {sii_ms} ms, a mail {mailbox_ms} ms");
        println!(
            "{:>6}  {}",
            "drives",
            MASTERS.map(|master| format!("{master:>36}")).join("")
        );
        for drives in DRIVES {
            let begun = Instant::now();
            let mut times = MASTERS.map(|_| Vec::new());
            let mut accesses = MASTERS.map(|_| (0, 0));
            for round in 0..ROUNDS {
                for (at, master) in MASTERS.iter().enumerate() {
                    if round < 3 || begun.elapsed() < LONG {
                        let (took, asked) = start(master, drives, sii_ms, mailbox_ms);
                        times[at].push(took);
                        accesses[at] = asked.max(accesses[at]);
                    }
                }
            }
            print!("{drives:>6}  ");
            let results = MASTERS.into_iter().zip(times).zip(accesses);
            for ((master, mut times), (sii, messages)) in results {
                times.sort_by(f64::total_cmp);
                let row = Row {
                    master,
                    drives,
                    sii_ms,
                    mailbox_ms,
                    times,
                };
                let spread = format!(
                    "{:.1} ({:.1} to {:.1}) {sii:>5} {messages:>4}",
                    row.median(),
                    row.times[0],
                    row.times[row.times.len() - 1]
                );
                print!("{spread:>36}");
                let _ = std::io::stdout().flush();
                rows.push(row);
            }
            println!();
        }
        println!();
    }
    let file = output();
    let text: Vec<String> = rows.iter().map(Row::json).collect();
    fs::create_dir_all(file.parent().expect("a directory"))
        .expect("the target directory can be written");
    fs::write(&file, format!("[\n{}\n]\n", text.join(",\n")))
        .expect("the target directory can be written");
    println!("{}", file.display());
    let slower = slower_than_soem(&rows);
    for row in &slower {
        println!(
            "{} drives at {} and {} ms: {:.1} ms to OP are more than SOEM's",
            row.drives,
            row.sii_ms,
            row.mailbox_ms,
            row.median()
        );
    }
    if !slower.is_empty() {
        exit(1);
    }
}

/// Our rows to OP whose median is above that of SOEM.
fn slower_than_soem(rows: &[Row]) -> Vec<&Row> {
    let of_line = |row: &Row| (row.drives, row.sii_ms, row.mailbox_ms);
    let ours = rows.iter().filter(|row| row.master == OURS);
    let slower = ours.filter(|ours| {
        let mut soem = rows.iter().filter(|row| row.master == SOEM);
        soem.any(|soem| of_line(soem) == of_line(ours) && ours.median() > soem.median())
    });
    slower.collect()
}

/// `target/bench/bring_up.json`, beside the profile's directory.
fn output() -> PathBuf {
    let program = env::current_exe().expect("this program has a path");
    let target = program.ancestors().nth(3).unwrap_or(Path::new("target"));
    target.join("bench/bring_up.json")
}

/// One start of one master on a line just switched on: milliseconds, and what was asked of the drive that was asked most.
fn start(master: &str, drives: usize, sii_ms: u32, mailbox_ms: u32) -> (f64, Asked) {
    let line = line(drives, sii_ms, mailbox_ms);
    let mut command = if master == SOEM {
        let mut python = Command::new(programs::python().expect("made before"));
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/bring_up/soem.py");
        python
            .arg("-B")
            .arg(script)
            .args(["master0", &drives.to_string()]);
        python
    } else {
        let mut own = Command::new(env::current_exe().expect("this program has a path"));
        own.args(["start", master, &drives.to_string()]);
        own
    };
    let output = command.output().expect("the master starts");
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(
        output.status.success(),
        "{master} with {drives} drives: {}\n{said}{}",
        output.status,
        String::from_utf8_lossy(&output.stderr)
    );
    let took = said.trim().parse();
    let took = took.unwrap_or_else(|_| panic!("{master}: {said}"));
    (took, asked(line))
}

/// Accesses to a drive's SII, and its messages.
type Asked = (u32, u32);

/// Ends the simulated line, which then says what each of its drives was asked.
fn asked(mut line: Process) -> Asked {
    run("kill", &["-TERM", &line.0.id().to_string()]);
    let mut said = String::new();
    let says = line.0.stdout.as_mut().expect("piped");
    says.read_to_string(&mut said).expect("text");
    let numbers = said.lines().filter_map(|line| {
        let (_, accesses) = line.split_once(": ")?;
        let (sii, messages) = accesses.split_once(" accesses to the SII, ")?;
        let messages = messages.strip_suffix(" messages")?;
        Some((sii.parse().ok()?, messages.parse().ok()?))
    });
    numbers
        .max()
        .unwrap_or_else(|| panic!("no numbers: {said}"))
}

fn line(drives: usize, sii_ms: u32, mailbox_ms: u32) -> Process {
    let delays = [
        "--sii-ms",
        &sii_ms.to_string(),
        "--mailbox-ms",
        &mailbox_ms.to_string(),
    ]
    .map(str::to_owned);
    namespace::simulated_with(
        &programs::simulator(),
        &vec!["akd2g"; drives],
        LONGEST,
        &delays,
    )
}
