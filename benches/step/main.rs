//! Instructions per axis and cycle, counted by callgrind: they repeat, whatever else the machine does.
//!
//! `cargo bench --bench step` prints a table, writes `target/bench/step.json` and fails above the bounds;
//! `STEP_PROFILE=1` shows the functions as well. What is counted: everything that the bus thread does for a cycle, for all
//! drives and axes: commands and the stop lane taken in, the outputs packed into the frames, what came back checked, judged
//! and unpacked, the axis cores stepped, reports and snapshots published. Not counted: what the link does to send and
//! receive, and the acyclic futures in the gap behind a cycle. What an axis costs is what a cycle of 256 axes costs more
//! than one of 8, divided by 248; what a cycle costs whatever the number of axes is the rest.

mod callgrind;
#[path = "../common/counted.rs"]
mod counted;
mod scenario;

use std::{
    env, fs,
    path::{Path, PathBuf},
};

use scenario::PHASES;

const AXES: [usize; 4] = [1, 8, 64, 256];
/// Of the axes counts, those between which the costs must be linear: with one axis the cycle's own costs prevail.
const LINEAR: [usize; 2] = [8, 256];

fn main() {
    let arguments: Vec<String> = env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["scenario", axes] => scenario::live(axes.parse().expect("a number of axes")),
        _ => measure(),
    }
}

/// One line of the result.
struct Row {
    phase: &'static str,
    axes: usize,
    per_cycle: f64,
}

impl Row {
    fn per_axis(&self) -> f64 {
        self.per_cycle / self.axes as f64
    }

    fn json(&self) -> String {
        format!(
            "{{\"phase\":\"{}\",\"axes\":{},\"per_cycle\":{:.1},\"per_axis\":{:.1}}}",
            self.phase,
            self.axes,
            self.per_cycle,
            self.per_axis()
        )
    }
}

fn measure() {
    if !callgrind::is_there() {
        println!("step: NOT MEASURED: there is no valgrind (apt-get install valgrind)");
        assert!(env::var_os("CI").is_none(), "CI measures");
        return;
    }
    let mut rows = Vec::new();
    for axes in AXES {
        let directory = target().join(format!("bench/step-{axes}"));
        let dumps = callgrind::run(&directory, &["scenario", &axes.to_string()]);
        assert_eq!(dumps.len(), PHASES.len(), "a dump for each phase");
        for (phase, dump) in PHASES.iter().zip(dumps) {
            let counted = dump.between("servocrab::bus::cycle::Cycle::", "Outside");
            rows.push(Row {
                phase: phase.name,
                axes,
                per_cycle: counted as f64 / phase.cycles as f64,
            });
            if env::var_os("STEP_PROFILE").is_some() && Some(&axes) == LINEAR.last() {
                println!("\n{} with {axes} axes, per axis and cycle:", phase.name);
                dump.print(axes * phase.cycles);
            }
        }
    }
    println!("instructions per axis and cycle (whole cycle), the exchange's own share included\n");
    print!("{:>12}", "axes");
    for axes in AXES {
        print!("{axes:>22}");
    }
    println!("{:>12}", "each more");
    let mut faults = Vec::new();
    for phase in &PHASES {
        let of = |axes: usize| {
            rows.iter()
                .find(|row| row.phase == phase.name && row.axes == axes)
                .expect("measured")
        };
        print!("{:>12}", phase.name);
        for axes in AXES {
            let row = of(axes);
            print!(
                "{:>22}",
                format!("{:.1} ({:.0})", row.per_axis(), row.per_cycle)
            );
        }
        let [few, many] = LINEAR.map(of);
        let each = (many.per_cycle - few.per_cycle) / (many.axes - few.axes) as f64;
        println!("{each:>12.1}");
        if each > phase.bound {
            faults.push(format!(
                "{}: {each:.1} instructions for each axis, at most {} are allowed",
                phase.name, phase.bound
            ));
        }
        let middle = of(64);
        let line = few.per_cycle + each * (middle.axes - few.axes) as f64;
        if (middle.per_cycle / line - 1.0).abs() > 0.05 {
            faults.push(format!(
                "{}: {:.0} instructions with {} axes, {line:.0} if it were linear",
                phase.name, middle.per_cycle, middle.axes
            ));
        }
    }
    let file = target().join("bench/step.json");
    let text: Vec<String> = rows.iter().map(Row::json).collect();
    fs::write(&file, format!("[\n{}\n]\n", text.join(",\n")))
        .expect("the target directory can be written");
    println!("\n{}", file.display());
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// The target directory, above the profile's.
fn target() -> PathBuf {
    let program = env::current_exe().expect("this program has a path");
    let target = program.ancestors().nth(3);
    target.unwrap_or(Path::new("target")).to_owned()
}
