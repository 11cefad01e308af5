//! The cycle of this library beside the system calls that it cannot do without, stock ethercrab and SOEM, in one run.
//!
//! `cargo bench --bench cycle` prints a table and writes `target/bench/cycle.json`. Each master has a veth pair of its own, all the
//! same reflector at the other end, on another core, which looks for frames without a system call: else all times come in steps of its
//! looks. As fast as possible (`fast`) a cycle's time is from the start of one sending to the start of the next; `fast-held` is the same
//! with every frame held at the other end for as long as a short line takes, so that each master that sleeps does sleep: without that it
//! goes by chance whether the answer is there before. At 1 kHz (`1kHz`) it is from when the cycle was due to when it was over, lateness of
//! waking up included. The rows `fast-simulated` are of one round against the
//! simulated segment. The rows `first` and `second` are of two networks in one process, at 8 axes each and 1 kHz; `alone` of one of
//! them while the other rests. `servocrab-awaited` has 64 tasks that wait for every cycle, on another thread of the same core; its row
//! `1kHz-woken` is from the receiving of the cycle's last frame until the last of them has run. Processor time of two networks is of the whole process, for each cycle of either. With numbers of axes, masters,
//! modes or `two` as arguments only those are measured.

mod floor;
mod measure;
#[path = "../../tests/common/namespace.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod namespace;
mod ours;
#[path = "../../tests/interop/programs.rs"]
#[allow(dead_code, reason = "the interop tests use more of it")]
mod programs;
#[path = "../../tests/common/python.rs"]
mod python;
mod reflector;
mod stock;
#[path = "../common/stock_set_up.rs"]
mod stock_set_up;
mod talk;
mod timer;
mod two;

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
};

use measure::{Measured, Mode};
use namespace::{INSIDE, veth_pair};
use rustix::thread::{CpuSet, sched_getaffinity};
use talk::Talk;
use timer::Timer;

const MASTERS: [&str; 8] = [
    "floor-block",
    "floor-spin",
    "servocrab-block",
    "servocrab-spin",
    "ethercrab-task",
    "ethercrab-uring",
    "pysoem",
    AWAITED,
];
/// `servocrab-block`, while 64 tasks on a thread of the same core wait for every cycle.
const AWAITED: &str = "servocrab-awaited";
/// Pairs of lines, each in one process.
const PAIRS: [[&str; 2]; 2] = [
    ["floor-first", "floor-second"],
    ["servocrab-first", "servocrab-second"],
];
/// Axes of each of two lines.
const AXES_OF_TWO: usize = 8;
const AXES: [usize; 4] = [1, 8, 64, 256];
/// Rounds in which the masters take their turns.
const ROUNDS: usize = 5;
/// Cycles of a round.
const FAST_CYCLES: usize = 4000;
const PACED_CYCLES: usize = 500;
/// Cycles of the one round against the simulated segment.
const SIMULATED_CYCLES: usize = 500;

fn main() {
    let arguments: Vec<String> = env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["reflect", axes, core] => {
            measure::pin(number(core));
            reflector::reflect(number(axes));
        }
        ["master", who, axes, core, frames] => {
            measure::pin(number(core));
            master(who, number(axes), Path::new(frames));
        }
        ["two", pair, axes, core, frames] => {
            measure::pin(number(core));
            both(number(pair), number(axes), Path::new(frames));
        }
        _ if env::var_os(INSIDE).is_some() => all(&arguments),
        _ => outside(&arguments),
    }
}

fn number(text: &str) -> usize {
    text.parse().expect("a number")
}

fn master(who: &str, axes: usize, frames: &Path) {
    let interface = format!("m{}", place_of(who));
    match who {
        "floor-block" => floor::floor(&interface, false, frames),
        "floor-spin" => floor::floor(&interface, true, frames),
        "servocrab-block" => ours::servocrab(&interface, axes, false, frames),
        "servocrab-spin" => ours::servocrab(&interface, axes, true, frames),
        AWAITED => ours::awaited(&interface, axes),
        "ethercrab-task" => stock::ethercrab(&interface, axes, false),
        _ => stock::ethercrab(&interface, axes, true),
    }
}

/// Two lines in this process.
fn both(pair: usize, axes: usize, frames: &Path) {
    let interfaces = PAIRS[pair].map(|who| format!("m{}", place_of(who)));
    let interfaces = interfaces.each_ref().map(String::as_str);
    if pair == 0 {
        two::two(interfaces, |interface| {
            floor::exchange(interface, false, frames)
        });
    } else {
        two::two(interfaces, |interface| {
            let mut line = ours::Line::bring_up(interface, axes, false);
            move |mode, count| line.measure(mode, count)
        });
    }
}

/// Who is at the near end of each cable.
fn lines() -> impl Iterator<Item = &'static str> {
    MASTERS.into_iter().chain(PAIRS.into_iter().flatten())
}

fn place_of(who: &str) -> usize {
    lines().position(|line| line == who).expect("one of them")
}

/// The far end of a master's cable.
fn slave(place: usize) -> String {
    format!("s{place}")
}

/// Makes the programs, and runs this one again inside a network namespace.
fn outside(arguments: &[String]) {
    if programs::python().is_none() {
        return;
    }
    // It ends with this process, however that ends. Ahead of other work, where that is allowed: as a session of its own, which the scheduler
    // weighs as a whole.
    let status = Command::new("setpriv")
        .args(["--pdeathsig", "KILL"])
        .args(["setsid", "--wait", "nice", "-n", "-20"])
        .args([
            "sh",
            "-c",
            "echo -20 2>&- >/proc/self/autogroup; exec \"$@\"",
            "sh",
        ])
        .args(["unshare", "-rn"])
        .arg(env::current_exe().expect("this program has a path"))
        .args(arguments)
        .env(INSIDE, "1")
        .status()
        .expect("unshare is there");
    assert!(status.success(), "{status}");
}

/// A row of the result.
struct Row {
    who: &'static str,
    axes: usize,
    mode: &'static str,
    measured: Measured,
}

impl Row {
    fn json(&self) -> String {
        let Measured {
            p50,
            p99,
            p999,
            max,
            cpu,
        } = self.measured;
        format!(
            "{{\"who\":\"{}\",\"axes\":{},\"mode\":\"{}\",\"p50_us\":{p50:.3},\"p99_us\":{p99:.3},\"p999_us\":{p999:.3},\
             \"max_us\":{max:.3},\"cpu_us\":{cpu:.3}}}",
            self.who, self.axes, self.mode
        )
    }

    fn print(&self) {
        let values = self.measured.values().map(|value| format!("{value:>10.2}"));
        println!(
            "{:<16} {:>4}  {:<14}{}",
            self.who,
            self.axes,
            self.mode,
            values.join("")
        );
    }
}

fn all(arguments: &[String]) {
    let chosen = Chosen::new(arguments);
    let cores = cores();
    for place in 0..lines().count() {
        let (near, far) = (format!("m{place}"), slave(place));
        veth_pair(&near, &far);
    }
    println!(
        "microseconds, medians of {ROUNDS} rounds; masters on core {}, the reflector on core {}\n",
        cores[0], cores[1]
    );
    println!(
        "{:<16} {:>4}  {:<14}{}",
        "who",
        "axes",
        "mode",
        ["p50", "p99", "p99.9", "max", "cpu"]
            .map(|name| format!("{name:>10}"))
            .join("")
    );
    let mut rows = Vec::new();
    for axes in AXES {
        if chosen.axes.contains(&axes) {
            rows.extend(with_axes(axes, cores, &chosen));
        }
    }
    let file = output();
    let text: Vec<String> = rows.iter().map(Row::json).collect();
    fs::write(&file, format!("[\n{}\n]\n", text.join(",\n")))
        .expect("the target directory can be written");
    println!("{}", file.display());
}

/// What is measured.
struct Chosen {
    axes: Vec<usize>,
    masters: Vec<&'static str>,
    modes: Vec<Mode>,
    two: bool,
}

impl Chosen {
    /// The modes in which this master takes its turns.
    fn modes_of(&self, who: &str) -> impl Iterator<Item = Mode> {
        let woken = (who == AWAITED).then_some(Mode::Woken);
        self.modes.clone().into_iter().chain(woken)
    }

    /// What the arguments name, or all.
    fn new(arguments: &[String]) -> Self {
        fn among<T>(
            all: impl IntoIterator<Item = T> + Clone,
            named: impl Fn(&T) -> bool,
        ) -> Vec<T> {
            let chosen: Vec<_> = all.clone().into_iter().filter(named).collect();
            if chosen.is_empty() {
                all.into_iter().collect()
            } else {
                chosen
            }
        }
        let named = |name: &str| arguments.iter().any(|text| text == name);
        let mut masters = among(MASTERS, |who| named(who));
        let none_named = masters.len() == MASTERS.len();
        let two = named("two");
        if two && none_named {
            masters.clear();
        }
        // The floor sends the frames of this one.
        if !masters.contains(&"servocrab-block") {
            masters.push("servocrab-block");
        }
        Self {
            axes: among(AXES, |axes| named(&axes.to_string())),
            masters,
            modes: among(Mode::IN_TURNS, |mode| named(mode.name())),
            two: two || none_named,
        }
    }
}

/// The first core that this process may use, for the masters, and the last, for the reflector.
fn cores() -> [usize; 2] {
    let set = sched_getaffinity(None).expect("it can be read");
    let mut allowed = (0..CpuSet::MAX_CPU).filter(|core| set.is_set(*core));
    let first = allowed.next().expect("a core");
    let Some(last) = allowed.next_back() else {
        panic!("master and reflector need a core each, and there is one");
    };
    [first, last]
}

/// `target/bench/cycle.json`, beside the profile's directory.
fn output() -> PathBuf {
    let program = env::current_exe().expect("this program has a path");
    let target = program.ancestors().nth(3).unwrap_or(Path::new("target"));
    let place = target.join("bench");
    fs::create_dir_all(&place).expect("the target directory can be written");
    place.join("cycle.json")
}

/// All masters with this number of axes, in turns.
fn with_axes(axes: usize, [core, other]: [usize; 2], chosen: &Chosen) -> Vec<Row> {
    let own = env::current_exe().expect("this program has a path");
    let mut reflector =
        Talk::start(Command::new(&own).args(["reflect", &axes.to_string(), &other.to_string()]));
    let frames = env::temp_dir().join(format!("servocrab-bench-{}.frames", std::process::id()));
    let mut rows = Vec::new();
    let mut masters: Vec<(usize, Talk)> = Vec::new();
    // This library before the floor, which sends its frames.
    for place in [2, 3, 4, 5, 6, 7, 0, 1] {
        if !chosen.masters.contains(&MASTERS[place]) {
            continue;
        }
        let (who, axes_text, core) = (MASTERS[place], axes.to_string(), core.to_string());
        let mut command = if who == "pysoem" {
            let mut python = Command::new(programs::python().expect("made before"));
            let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/cycle/soem.py");
            let interface = format!("m{place}");
            python.arg("-B").arg(script);
            python.args([&interface, &axes_text, &core]);
            python
        } else {
            let mut program = Command::new(&own);
            program
                .args(["master", who, &axes_text, &core])
                .arg(&frames);
            program
        };
        let simulated = !who.starts_with("floor");
        if simulated {
            reflector.ask(&format!("simulate {place}"));
        }
        let mut master = Talk::start(&mut command);
        if simulated {
            let row = Row {
                who,
                axes,
                mode: Mode::Simulated.name(),
                measured: master.measure(Mode::Simulated, SIMULATED_CYCLES),
            };
            row.print();
            rows.push(row);
        }
        masters.push((place, master));
    }
    let mut pairs = Vec::new();
    if chosen.two && axes == AXES_OF_TWO {
        for (pair, who) in PAIRS.into_iter().enumerate() {
            let [first, second] = who.map(place_of);
            reflector.ask(&format!("simulate {first} {second}"));
            let mut program = Command::new(&own);
            program.args(["two", &pair.to_string(), &axes.to_string()]);
            pairs.push(Talk::start(program.arg(core.to_string()).arg(&frames)));
        }
    }
    let _ = fs::remove_file(&frames);
    masters.sort_by_key(|(place, _)| *place);
    let mut measured = Vec::new();
    for _ in 0..ROUNDS {
        for (place, master) in &mut masters {
            for mode in chosen.modes_of(MASTERS[*place]) {
                let how = if mode == Mode::Held {
                    "hold"
                } else {
                    "reflect"
                };
                reflector.ask(&format!("{how} {place}"));
                let cycles = match mode {
                    Mode::Paced | Mode::Woken => PACED_CYCLES,
                    Mode::Fast | Mode::Held | Mode::Simulated => FAST_CYCLES,
                };
                let timer =
                    (!matches!(mode, Mode::Paced | Mode::Woken)).then(|| Timer::start(core));
                measured.push((*place, mode, master.measure(mode, cycles)));
                drop(timer);
            }
        }
    }
    for mode in chosen.modes_of(AWAITED) {
        for (place, who) in MASTERS.into_iter().enumerate() {
            let rounds = measured
                .iter()
                .filter(|(at, of, _)| (*at, *of) == (place, mode));
            let is_measured =
                chosen.masters.contains(&who) && chosen.modes_of(who).any(|of| of == mode);
            if !is_measured {
                continue;
            }
            let row = Row {
                who,
                axes,
                mode: mode.name(),
                measured: medians(rounds.map(|(.., measured)| *measured)),
            };
            row.print();
            rows.push(row);
        }
        println!();
    }
    if !pairs.is_empty() {
        rows.extend(two::in_turns(&mut pairs, &mut reflector, axes));
    }
    rows
}

fn medians(rounds: impl Iterator<Item = Measured>) -> Measured {
    let rounds: Vec<_> = rounds.map(|measured| measured.values()).collect();
    Measured::from_values(std::array::from_fn(|at| {
        let mut values: Vec<f64> = rounds.iter().map(|values| values[at]).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    }))
}
