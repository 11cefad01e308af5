//! Machines told by files.

use std::{fs, path::Path};

use super::{Finding, Verdict, machine};

/// A machine told by these files.
fn told(files: &[(&str, &str)]) -> tempfile::TempDir {
    let root = tempfile::tempdir().unwrap();
    for (file, text) in files {
        let file = root.path().join(file);
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(file, text).unwrap();
    }
    root
}

fn verdicts(root: &Path) -> Vec<(&'static str, Verdict, String)> {
    let told = |finding: Finding| {
        assert_eq!(finding.change.is_some(), finding.verdict == Verdict::Change);
        (finding.check, finding.verdict, finding.found)
    };
    machine(root).into_iter().map(told).collect()
}

#[test]
fn a_machine_made_for_it_has_nothing_to_change() {
    let root = told(&[
        ("sys/kernel/realtime", "1\n"),
        ("proc/sys/kernel/sched_rt_runtime_us", "-1\n"),
        ("sys/devices/system/cpu/isolated", "3\n"),
        ("sys/devices/system/cpu/nohz_full", "3\n"),
        (
            "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor",
            "performance\n",
        ),
        (
            "sys/devices/system/cpu/cpu3/cpufreq/scaling_governor",
            "performance\n",
        ),
        ("sys/devices/system/cpu/cpu3/cpuidle/state1/latency", "2\n"),
        ("sys/devices/system/cpu/cpu3/cpuidle/state1/disable", "0\n"),
        ("sys/devices/system/cpu/cpu3/cpuidle/state1/name", "C1\n"),
        (
            "sys/devices/system/cpu/cpu3/cpuidle/state2/latency",
            "133\n",
        ),
        ("sys/devices/system/cpu/cpu3/cpuidle/state2/disable", "1\n"),
        (
            "sys/devices/system/clocksource/clocksource0/current_clocksource",
            "tsc\n",
        ),
        ("proc/swaps", "Filename Type Size Used Priority\n"),
        ("proc/12/comm", "systemd\n"),
        ("proc/cpuinfo", "processor : 0\nflags : fpu tsc\n"),
    ]);
    for (check, verdict, found) in verdicts(root.path()) {
        assert_eq!(verdict, Verdict::Good, "{check}: {found}");
    }
}

#[test]
fn a_desktop_is_told_each_thing_that_it_has_to_change() {
    let root = told(&[
        ("proc/version", "Linux version 6.1 #1 SMP PREEMPT_DYNAMIC\n"),
        ("proc/sys/kernel/sched_rt_runtime_us", "950000\n"),
        ("sys/devices/system/cpu/isolated", "\n"),
        (
            "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor",
            "powersave\n",
        ),
        (
            "sys/devices/system/cpu/cpu1/cpufreq/scaling_governor",
            "performance\n",
        ),
        (
            "sys/devices/system/cpu/cpu0/cpuidle/state3/latency",
            "133\n",
        ),
        ("sys/devices/system/cpu/cpu0/cpuidle/state3/disable", "0\n"),
        ("sys/devices/system/cpu/cpu0/cpuidle/state3/name", "C6\n"),
        (
            "sys/devices/system/clocksource/clocksource0/current_clocksource",
            "hpet\n",
        ),
        (
            "proc/swaps",
            "Filename Type Size Used Priority\n/dev/sda2 partition 1 0 -2\n",
        ),
        ("proc/77/comm", "irqbalance\n"),
        (
            "proc/cpuinfo",
            "processor : 0\nflags : fpu hypervisor tsc\n",
        ),
    ]);
    let found: Vec<_> = verdicts(root.path())
        .into_iter()
        .map(|(_, verdict, found)| {
            assert_eq!(verdict, Verdict::Change, "{found}");
            found
        })
        .collect();
    let expected = [
        "PREEMPT_DYNAMIC",
        "950000 µs per period",
        "none of 2",
        "powersave",
        "C6 takes 133 µs to wake",
        "hpet",
        "on",
        "irqbalance moves interrupts",
        "virtual",
    ];
    assert_eq!(found, expected);
}

#[test]
fn a_new_kernel_is_asked_for_its_fair_servers() {
    let throttling = |files: &[(&str, &str)]| {
        let finding = super::throttling(told(files).path());
        (finding.verdict, finding.found)
    };
    let release = ("proc/sys/kernel/osrelease", "6.18.4-rt1\n");
    let old = ("proc/sys/kernel/sched_rt_runtime_us", "-1\n");
    let server = "sys/kernel/debug/sched/fair_server/cpu3/runtime";
    assert_eq!(throttling(&[release, old]).0, Verdict::Unknown);
    assert_eq!(
        throttling(&[release, old, (server, "50000000\n")]),
        (Verdict::Change, "by the fair server of cpu3".into())
    );
    assert_eq!(throttling(&[release, (server, "0\n")]).0, Verdict::Good);
    let before = ("proc/sys/kernel/osrelease", "6.11.0\n");
    assert_eq!(throttling(&[before, old]).0, Verdict::Good);
}

#[test]
fn where_the_system_says_nothing_nothing_is_made_up() {
    let root = told(&[]);
    let unknown = verdicts(root.path())
        .into_iter()
        .filter(|(_, verdict, _)| *verdict == Verdict::Unknown)
        .count();
    assert_eq!(unknown, 6);
}
