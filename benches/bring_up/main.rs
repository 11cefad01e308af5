//! Cold start of a line of two-axis drives on a veth pair: this library, stock ethercrab and SOEM side by side.
//!
//! `cargo bench --bench bring_up` prints a table and writes `target/bench/bring_up.json`. Of this library it shows the time to OP, to the end
//! of `start`, by when all that motion needs was read, and to the first enabled axis; of SOEM the time to OP, and until its own calls have
//! read the same. It exits with 1 where a bound of [`missed`] is not kept. Every start has a simulated line that was just switched on. Times
//! are of this machine and this run; what counts is how they compare. Behind them stands what the simulated drives counted: accesses to
//! the SII (of eight bytes at most) and messages, of the drive that had most.

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
const SOEM: &str = "pysoem";
/// Each master, and what it gives the time of.
const MASTERS: [(&str, &[&str]); 3] = [
    (OURS, &["OP", "start", "enabled"]),
    ("ethercrab", &["OP"]),
    (SOEM, &["OP", "same reads"]),
];
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
                OURS => masters::servocrab("master0", drives),
                _ => masters::ethercrab("master0", drives),
            };
            for took in took {
                println!("{}", took.as_secs_f64() * 1e3);
            }
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
    to: &'static str,
    drives: usize,
    sii_ms: u32,
    mailbox_ms: u32,
    /// Milliseconds, in order.
    times: Vec<f64>,
    asked: Asked,
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
            "{{\"master\":\"{}\",\"to\":\"{}\",\"drives\":{},\"sii_ms\":{},\"mailbox_ms\":{},\"median_ms\":{:.3},\"min_ms\":{:.3},\"max_ms\":{:.3}}}",
            self.master,
            self.to,
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
        "milliseconds from power-on: median (least to most) of up to {ROUNDS} starts, taken in turns; behind a master's last one accesses to the \
         SII and messages of one drive\n"
    );
    let mut rows: Vec<Row> = Vec::new();
    for (sii_ms, mailbox_ms) in DELAYS {
        println!("an access to the EEPROM takes {sii_ms} ms, a mail {mailbox_ms} ms");
        print!("{:>6}  ", "drives");
        for (master, marks) in MASTERS {
            for to in marks {
                print!("{:>26}", format!("{master}: {to}"));
            }
            print!("{:>10}", "");
        }
        println!();
        for drives in DRIVES {
            let begun = Instant::now();
            let first = rows.len();
            rows.extend(MASTERS.iter().flat_map(|&(master, marks)| {
                marks.iter().map(move |to| Row {
                    master,
                    to,
                    drives,
                    sii_ms,
                    mailbox_ms,
                    times: Vec::new(),
                    asked: (0, 0),
                })
            }));
            for round in 0..ROUNDS {
                let mut of_masters = &mut rows[first..];
                for (master, marks) in MASTERS {
                    let (own, others) = of_masters.split_at_mut(marks.len());
                    of_masters = others;
                    if round < 3 || begun.elapsed() < LONG {
                        let (took, asked) = start(master, drives, sii_ms, mailbox_ms);
                        assert_eq!(took.len(), own.len(), "{master}");
                        for (row, took) in own.iter_mut().zip(took) {
                            row.times.push(took);
                            row.asked = asked.max(row.asked);
                        }
                    }
                }
            }
            print!("{drives:>6}  ");
            for of_master in rows[first..].chunk_by_mut(|one, next| one.master == next.master) {
                for row in &mut *of_master {
                    row.times.sort_by(f64::total_cmp);
                    let most = row.times[row.times.len() - 1];
                    let spread = format!("{:.1} ({:.1} to {most:.1})", row.median(), row.times[0]);
                    print!("{spread:>26}");
                }
                let (sii, messages) = of_master[0].asked;
                print!("{sii:>5} {messages:>4}");
            }
            println!();
            let _ = std::io::stdout().flush();
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
    let missed = missed(&rows);
    for bound in &missed {
        println!("{bound}");
    }
    if !missed.is_empty() {
        exit(1);
    }
}

/// Of one drive without delays: it counts the line twice, 20 ms apart, and that is worth more.
const ALONE: f64 = 1.6;
/// A start of the longest line with delays, as a part of that of one drive.
const LONGEST_LINE: f64 = 1.5;
/// Accesses to the SII and messages of one drive of two axes.
const MOST_ASKED: Asked = (16, 80);

/// The bounds that are not kept: `start` within what SOEM takes for the same reads; with delays, the longest line within half as much again
/// as one drive; what one drive is asked.
fn missed(rows: &[Row]) -> Vec<String> {
    let mut missed = Vec::new();
    let of_line = |row: &Row| (row.drives, row.sii_ms, row.mailbox_ms);
    let starts = || {
        rows.iter()
            .filter(|row| (row.master, row.to) == (OURS, "start"))
    };
    for ours in starts() {
        let line = of_line(ours);
        let bound = if line == (1, 0, 0) { ALONE } else { 1.0 };
        let soem = rows
            .iter()
            .find(|row| (row.master, row.to) == (SOEM, "same reads") && of_line(row) == line);
        let soem = soem.expect("each line is measured with both").median();
        if ours.median() > bound * soem {
            let took = ours.median();
            missed.push(format!(
                "{line:?}: {took:.1} ms are more than {bound} times SOEM's {soem:.1} ms"
            ));
        }
        if ours.asked.0 > MOST_ASKED.0 || ours.asked.1 > MOST_ASKED.1 {
            missed.push(format!(
                "{line:?}: one drive was asked {:?}, and not {MOST_ASKED:?}",
                ours.asked
            ));
        }
    }
    let with_delays: Vec<_> = starts().filter(|row| row.mailbox_ms > 0).collect();
    if let [one, .., most] = with_delays[..]
        && most.times[0] > LONGEST_LINE * one.times[0]
    {
        // The least of each: 32 simulated drives share the processors with whatever else runs.
        let (one, most) = (one.times[0], most.times[0]);
        missed.push(format!(
            "the longest line takes {most:.1} ms, more than {LONGEST_LINE} times the {one:.1} ms of one drive"
        ));
    }
    missed
}

/// `target/bench/bring_up.json`, beside the profile's directory.
fn output() -> PathBuf {
    let program = env::current_exe().expect("this program has a path");
    let target = program.ancestors().nth(3).unwrap_or(Path::new("target"));
    target.join("bench/bring_up.json")
}

/// One start of one master on a line just switched on: milliseconds to each mark, and what was asked of the drive that was asked most.
fn start(master: &str, drives: usize, sii_ms: u32, mailbox_ms: u32) -> (Vec<f64>, Asked) {
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
    let took: Result<_, _> = said.split_whitespace().map(str::parse).collect();
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
