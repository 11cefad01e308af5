//! What every master of this bench does: waits for an order, runs its cycles, says what they took.

use std::{
    io::{self, BufRead, Write},
    process,
    time::Duration,
};

use rustix::{
    thread::{ClockId as SleepClock, CpuSet, clock_nanosleep_absolute, sched_setaffinity},
    time::{ClockId, Timespec, clock_gettime},
};

/// One millisecond.
pub(crate) const PERIOD_NS: u64 = 1_000_000;

/// How long the reflector holds a frame: as long as the shortest frame takes on 100 Mbit/s, and then some ten devices.
pub(crate) const HELD_FOR: Duration = Duration::from_micros(20);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Mode {
    /// One cycle behind the other.
    Fast,
    /// One cycle behind the other, each frame held for [`HELD_FOR`] at the other end.
    Held,
    /// One cycle a millisecond.
    Paced,
    /// One cycle behind the other, against the simulated segment.
    Simulated,
    /// One cycle a millisecond: from the receiving of its last frame until the last of the tasks that wait for it has run.
    Woken,
}

impl Mode {
    /// Those that the masters take turns in.
    pub(crate) const IN_TURNS: [Self; 3] = [Self::Fast, Self::Held, Self::Paced];

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Fast => "fast",
            Self::Held => "fast-held",
            Self::Paced => "1kHz",
            Self::Simulated => "fast-simulated",
            Self::Woken => "1kHz-woken",
        }
    }
}

/// What some cycles took, in microseconds.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Measured {
    pub(crate) p50: f64,
    pub(crate) p99: f64,
    pub(crate) p999: f64,
    pub(crate) max: f64,
    /// Processor time of the whole process for each cycle.
    pub(crate) cpu: f64,
}

impl Measured {
    /// Of the nanoseconds of each cycle, and the processor's time for all of them.
    pub(crate) fn new(mut nanoseconds: Vec<u64>, cpu_ns: u64) -> Self {
        nanoseconds.sort_unstable();
        let count = nanoseconds.len();
        let at = |part: f64| {
            let place = ((count - 1) as f64 * part).round() as usize;
            nanoseconds[place] as f64 / 1e3
        };
        Self {
            p50: at(0.5),
            p99: at(0.99),
            p999: at(0.999),
            max: at(1.0),
            cpu: cpu_ns as f64 / count as f64 / 1e3,
        }
    }

    pub(crate) fn values(&self) -> [f64; 5] {
        [self.p50, self.p99, self.p999, self.max, self.cpu]
    }

    pub(crate) fn from_values(values: [f64; 5]) -> Self {
        let [p50, p99, p999, max, cpu] = values;
        Self {
            p50,
            p99,
            p999,
            max,
            cpu,
        }
    }
}

/// Says that the master is ready, and measures as often as it is asked to.
pub(crate) fn serve(mut run: impl FnMut(Mode, usize) -> Measured) {
    say("ready");
    for line in io::stdin().lock().lines() {
        let line = line.expect("text");
        let (mode, cycles) = line.split_once(' ').expect("a mode and a number of cycles");
        let modes = [
            Mode::Fast,
            Mode::Held,
            Mode::Paced,
            Mode::Simulated,
            Mode::Woken,
        ];
        let mode = modes.into_iter().find(|one| one.name() == mode);
        let mode = mode.expect("one of them");
        let measured = run(mode, cycles.parse().expect("a number"));
        say(&measured.values().map(|value| value.to_string()).join(" "));
    }
    // Without taking the line down in order: nobody is there any more.
    process::exit(0);
}

pub(crate) fn say(text: &str) {
    println!("{text}");
    io::stdout().flush().expect("whoever asked is there");
}

/// Runs the closure once a cycle and takes the time of each: as fast as possible from start to start, else from when a cycle was due
/// to its end. `spin` waits for the time without sleeping.
pub(crate) fn cycles(mode: Mode, count: usize, spin: bool, mut cycle: impl FnMut()) -> Measured {
    let mut times = Vec::with_capacity(count);
    let cpu = cpu_ns();
    match mode {
        Mode::Fast | Mode::Held | Mode::Simulated => {
            let mut start = now_ns();
            for _ in 0..count {
                cycle();
                let next = now_ns();
                times.push(next - start);
                start = next;
            }
        }
        Mode::Paced | Mode::Woken => {
            let mut due = now_ns();
            for _ in 0..count {
                due += PERIOD_NS;
                wait_until(due, spin);
                cycle();
                let end = now_ns();
                times.push(end - due);
                // Cycles that were slept through are not made up for.
                due = due.max(end.saturating_sub(PERIOD_NS));
            }
        }
    }
    Measured::new(times, cpu_ns() - cpu)
}

fn wait_until(due: u64, spin: bool) {
    if spin {
        while now_ns() < due {
            std::hint::spin_loop();
        }
        return;
    }
    let due = Timespec {
        tv_sec: (due / 1_000_000_000) as i64,
        tv_nsec: (due % 1_000_000_000) as i64,
    };
    // A signal wakes early: none is sent here.
    let _ = clock_nanosleep_absolute(SleepClock::Monotonic, &due);
}

pub(crate) fn now_ns() -> u64 {
    nanoseconds(clock_gettime(ClockId::Monotonic))
}

/// Processor time of this process.
pub(crate) fn cpu_ns() -> u64 {
    nanoseconds(clock_gettime(ClockId::ProcessCPUTime))
}

fn nanoseconds(time: Timespec) -> u64 {
    time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
}

/// Keeps this process, and every thread that it makes later, on one core.
pub(crate) fn pin(core: usize) {
    let mut set = CpuSet::new();
    set.set(core);
    sched_setaffinity(None, &set).expect("the core is there");
}
