//! What the system's own files say about the machine.

use std::{
    fmt, fs,
    path::{Path, PathBuf},
};

/// What is to be thought of something found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Verdict {
    Good,
    /// Something ought to be changed.
    Change,
    /// The system does not say.
    Unknown,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Good => "good",
            Self::Change => "change",
            Self::Unknown => "unknown",
        })
    }
}

/// One thing looked at.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Finding {
    pub(crate) check: &'static str,
    pub(crate) verdict: Verdict,
    pub(crate) found: String,
    pub(crate) change: Option<String>,
}

impl Finding {
    pub(crate) fn good(check: &'static str, found: impl Into<String>) -> Self {
        Self {
            check,
            verdict: Verdict::Good,
            found: found.into(),
            change: None,
        }
    }

    pub(crate) fn change(
        check: &'static str,
        found: impl Into<String>,
        change: impl Into<String>,
    ) -> Self {
        Self {
            check,
            verdict: Verdict::Change,
            found: found.into(),
            change: Some(change.into()),
        }
    }

    pub(crate) fn unknown(check: &'static str, found: impl Into<String>) -> Self {
        Self {
            check,
            verdict: Verdict::Unknown,
            found: found.into(),
            change: None,
        }
    }

    /// Something that was tried; its error says what to change.
    pub(crate) fn of_attempt(
        check: &'static str,
        done: &str,
        error: Option<impl fmt::Display>,
    ) -> Self {
        match error {
            None => Self::good(check, done),
            Some(error) => Self::change(check, "refused", error.to_string()),
        }
    }
}

/// Everything about the machine but its interface and its timer. `root` is `/`.
pub(crate) fn machine(root: &Path) -> Vec<Finding> {
    let checks = [
        preemption,
        throttling,
        isolation,
        governor,
        idle_states,
        clock_source,
        swap,
        irq_balance,
        virtual_machine,
    ];
    checks.iter().map(|check| check(root)).collect()
}

/// The file's text without its last line break; none if it cannot be read.
pub(crate) fn text(root: &Path, file: &str) -> Option<String> {
    let text = fs::read_to_string(root.join(file)).ok()?;
    Some(text.trim_end().to_owned())
}

/// The directories `0`, `1` and so on of each processor.
fn processors(root: &Path) -> Vec<PathBuf> {
    let all = fs::read_dir(root.join("sys/devices/system/cpu"));
    let mut found: Vec<_> = all
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| {
            let name = path.file_name().and_then(|name| name.to_str());
            let number = name.and_then(|name| name.strip_prefix("cpu"));
            number.is_some_and(|number| {
                !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit())
            })
        })
        .collect();
    found.sort();
    found
}

fn preemption(root: &Path) -> Finding {
    let check = "kernel preemption";
    let version = text(root, "proc/version").unwrap_or_default();
    if text(root, "sys/kernel/realtime").as_deref() == Some("1") || version.contains("PREEMPT_RT") {
        return Finding::good(check, "PREEMPT_RT");
    }
    let found = ["PREEMPT_DYNAMIC", "PREEMPT"]
        .into_iter()
        .find(|kind| version.contains(kind))
        .unwrap_or("not a preemptible kernel");
    Finding::change(
        check,
        found,
        "use a kernel with PREEMPT_RT (Debian: linux-image-rt-amd64; Ubuntu: the real-time kernel), so that drivers do not hold \
         the bus thread up",
    )
}

/// From Linux 6.12 on ordinary threads get their share by a deadline server of each processor, and `sched_rt_runtime_us` no longer
/// throttles threads outside of control groups (sched/deadline: "fair server").
fn fair_server(root: &Path) -> Option<Finding> {
    let check = "real-time throttling";
    let release = text(root, "proc/sys/kernel/osrelease")?;
    let mut numbers = release
        .split(['.', '-'])
        .map_while(|part| part.parse::<u32>().ok());
    if (numbers.next()?, numbers.next()?) < (6, 12) {
        return None;
    }
    let servers = root.join("sys/kernel/debug/sched/fair_server");
    let Ok(entries) = fs::read_dir(&servers) else {
        return Some(Finding::unknown(
            check,
            format!(
                "by the fair server of Linux {release}: /sys/kernel/debug/sched/fair_server cannot be read"
            ),
        ));
    };
    let mut on: Vec<_> = entries
        .flatten()
        .filter(|entry| text(&entry.path(), "runtime").is_some_and(|runtime| runtime != "0"))
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    on.sort();
    if on.is_empty() {
        return Some(Finding::good(check, "off"));
    }
    Some(Finding::change(
        check,
        format!("by the fair server of {}", on.join(", ")),
        "a real-time thread that spins is taken off its processor for a part of each period when others wait for it: \
         `echo 0 > /sys/kernel/debug/sched/fair_server/cpuN/runtime` for its processor, or let it block",
    ))
}

fn throttling(root: &Path) -> Finding {
    let check = "real-time throttling";
    if let Some(finding) = fair_server(root) {
        return finding;
    }
    match text(root, "proc/sys/kernel/sched_rt_runtime_us").as_deref() {
        None => Finding::unknown(check, "not stated by the system"),
        Some("-1") => Finding::good(check, "off"),
        Some(runtime) => Finding::change(
            check,
            format!("{runtime} µs per period"),
            "a real-time thread that spins is taken off its processor for the rest of each period: \
             `sysctl -w kernel.sched_rt_runtime_us=-1`, or let it block",
        ),
    }
}

fn isolation(root: &Path) -> Finding {
    let check = "isolated processors";
    let count = processors(root).len();
    let read = |file| text(root, file).filter(|list| !list.is_empty() && list != "(null)");
    let isolated = read("sys/devices/system/cpu/isolated");
    let tickless = read("sys/devices/system/cpu/nohz_full");
    match (isolated, tickless) {
        (Some(isolated), Some(tickless)) => Finding::good(
            check,
            format!("{isolated} of {count}, without ticks: {tickless}"),
        ),
        (isolated, _) => Finding::change(
            check,
            format!("{} of {count}", isolated.as_deref().unwrap_or("none")),
            "keep other work off the bus thread's processor: `isolcpus=N nohz_full=N rcu_nocbs=N` on the kernel's command line, \
             and `RealTime::processors([N])`",
        ),
    }
}

fn governor(root: &Path) -> Finding {
    let check = "frequency governor";
    let mut others: Vec<String> = Vec::new();
    let mut seen = false;
    for processor in processors(root) {
        if let Some(governor) = text(&processor, "cpufreq/scaling_governor") {
            seen = true;
            if governor != "performance" && !others.contains(&governor) {
                others.push(governor);
            }
        }
    }
    if !seen {
        Finding::unknown(
            check,
            "the system does not change frequencies, or does not say",
        )
    } else if others.is_empty() {
        Finding::good(check, "performance")
    } else {
        Finding::change(
            check,
            others.join(", "),
            "`cpupower frequency-set -g performance`",
        )
    }
}

/// Waking from a deeper idle state than this takes a share of a cycle that shows, in microseconds.
const LONG_WAKE: u32 = 20;

fn idle_states(root: &Path) -> Finding {
    let check = "idle states";
    let mut deepest: Option<(u32, String)> = None;
    for processor in processors(root) {
        let states = fs::read_dir(processor.join("cpuidle"));
        for state in states.into_iter().flatten().flatten() {
            let state = state.path();
            let latency = text(&state, "latency").and_then(|latency| latency.parse().ok());
            let enabled = text(&state, "disable").as_deref() == Some("0");
            if let (Some(latency), true) = (latency, enabled)
                && deepest.as_ref().is_none_or(|(most, _)| latency > *most)
            {
                deepest = Some((latency, text(&state, "name").unwrap_or_default()));
            }
        }
    }
    match deepest {
        None => Finding::unknown(check, "the system does not say"),
        Some((latency, name)) if latency <= LONG_WAKE => Finding::good(
            check,
            format!("the deepest is {name}, {latency} µs to wake"),
        ),
        Some((latency, name)) => Finding::change(
            check,
            format!("{name} takes {latency} µs to wake"),
            "`cpupower idle-set -D 20`, or a program that holds /dev/cpu_dma_latency at 0 while the machine runs",
        ),
    }
}

fn clock_source(root: &Path) -> Finding {
    let check = "clock source";
    let file = "sys/devices/system/clocksource/clocksource0/current_clocksource";
    match text(root, file).as_deref() {
        None => Finding::unknown(check, "not stated by the system"),
        Some(slow @ ("hpet" | "acpi_pm" | "jiffies" | "refined-jiffies" | "xen")) => {
            Finding::change(
                check,
                slow,
                "each look at this clock is a system call or slower: `clocksource=tsc` on the kernel's command line, where the \
                 processor's counter is stable",
            )
        }
        Some(source) => Finding::good(check, source),
    }
}

fn swap(root: &Path) -> Finding {
    let check = "swap";
    match text(root, "proc/swaps") {
        None => Finding::unknown(check, "not stated by the system"),
        // The first line is a heading.
        Some(swaps) if swaps.lines().count() > 1 => Finding::change(
            check,
            "on",
            "`RealTime::lock_memory()` keeps the program in RAM, or `swapoff -a`",
        ),
        Some(_) => Finding::good(check, "off"),
    }
}

fn irq_balance(root: &Path) -> Finding {
    let check = "interrupt placement";
    let processes = fs::read_dir(root.join("proc"));
    let runs = processes
        .into_iter()
        .flatten()
        .flatten()
        .any(|process| text(&process.path(), "comm").as_deref() == Some("irqbalance"));
    if runs {
        Finding::change(
            check,
            "irqbalance moves interrupts",
            "`systemctl disable --now irqbalance`, and give the interface's interrupt to a processor next to the bus thread's \
             (/proc/irq/N/smp_affinity_list)",
        )
    } else {
        Finding::good(check, "nobody moves interrupts")
    }
}

fn virtual_machine(root: &Path) -> Finding {
    let check = "machine";
    let Some(info) = text(root, "proc/cpuinfo") else {
        return Finding::unknown(check, "not stated by the system");
    };
    let virtual_one = info.lines().any(|line| {
        line.starts_with("flags") && line.split_whitespace().any(|flag| flag == "hypervisor")
    });
    if virtual_one {
        Finding::change(
            check,
            "virtual",
            "its host takes the processors away when it likes: run the bus on real hardware, or pin and isolate the virtual \
             processors on the host",
        )
    } else {
        Finding::good(check, "no hypervisor is reported")
    }
}

#[cfg(test)]
#[path = "checks_tests.rs"]
mod tests;
