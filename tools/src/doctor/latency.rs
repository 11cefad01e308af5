//! How late a thread wakes up, measured.

use std::{
    num::NonZero,
    thread,
    time::{Duration, Instant},
};

use hdrhistogram::Histogram;
use indicatif::{ProgressBar, ProgressStyle};
use rustix::thread::{ClockId, Timespec, clock_nanosleep_absolute, set_current_timer_slack};
use servocrab::bus::{RealTime, Scheduling};

use super::checks::Finding;
use crate::output::{Interrupted, Tool};

/// Measures as an ordinary thread and, where that is allowed, as a real-time one.
pub(crate) fn measure(
    tool: &Tool,
    cycle: Duration,
    time: Duration,
    priority: u8,
) -> Result<Vec<Finding>, Interrupted> {
    let cycles = u64::try_from(time.as_nanos() / cycle.as_nanos())
        .unwrap_or(u64::MAX)
        .max(1);
    let bar = ProgressBar::new(2 * cycles);
    bar.set_style(
        ProgressStyle::with_template("measuring the timer {bar:40} {eta}")
            .unwrap_or_else(|_| ProgressStyle::default_bar()),
    );
    let ordinary = wake_ups(cycle, cycles, RealTime::new(), tool, bar.clone());
    let scheduling = RealTime::new().scheduling(Scheduling::Fifo(priority));
    let real_time = wake_ups(cycle, cycles, scheduling, tool, bar.clone());
    bar.finish_and_clear();
    if tool.is_interrupted() {
        return Err(Interrupted);
    }
    let mut findings = Vec::new();
    findings.extend(ordinary.map(|late| told("timer, ordinary thread", cycle, &late)));
    findings.extend(real_time.map(|late| told("timer, SCHED_FIFO 80", cycle, &late)));
    Ok(findings)
}

/// How late a thread wakes up each cycle, in nanoseconds; none if it may not have this real time.
fn wake_ups(
    cycle: Duration,
    cycles: u64,
    real_time: RealTime,
    tool: &Tool,
    bar: ProgressBar,
) -> Option<Histogram<u64>> {
    let ended = tool.interrupt();
    let thread = thread::spawn(move || {
        real_time.apply().ok()?;
        // As the bus thread does: an ordinary thread is woken up to 50 µs later else, together with others.
        set_current_timer_slack(Some(NonZero::<u64>::MIN)).ok()?;
        // From a nanosecond to a minute, three digits.
        let mut late = Histogram::<u64>::new_with_bounds(1, 60_000_000_000, 3).ok()?;
        let clock = ClockId::Monotonic;
        let (since, begun) = (rustix::time::clock_gettime(clock), Instant::now());
        for number in 1..=cycles {
            let due = cycle.saturating_mul(u32::try_from(number).unwrap_or(u32::MAX));
            while clock_nanosleep_absolute(clock, &after(since, due)).is_err() {}
            let by = begun.elapsed().saturating_sub(due);
            late.saturating_record(u64::try_from(by.as_nanos()).unwrap_or(u64::MAX));
            if number % 64 == 0 {
                bar.inc(64);
            }
            if ended.is_closed() {
                return None;
            }
        }
        Some(late)
    });
    thread.join().ok().flatten()
}

fn after(since: Timespec, due: Duration) -> Timespec {
    let nanoseconds = since.tv_nsec + i64::from(due.subsec_nanos());
    Timespec {
        tv_sec: since.tv_sec + due.as_secs().cast_signed() + nanoseconds / 1_000_000_000,
        tv_nsec: nanoseconds % 1_000_000_000,
    }
}

fn told(check: &'static str, cycle: Duration, late: &Histogram<u64>) -> Finding {
    let microseconds = |nanoseconds: u64| nanoseconds as f64 / 1e3;
    let found = format!(
        "late by {:.1} µs (median), {:.1} (99 %), {:.1} (worst of {})",
        microseconds(late.value_at_quantile(0.5)),
        microseconds(late.value_at_quantile(0.99)),
        microseconds(late.max()),
        late.len()
    );
    // The bus loop calls a cycle late that begins half a cycle after its time.
    if Duration::from_nanos(late.max()) < cycle / 2 {
        Finding::good(check, found)
    } else {
        Finding::change(
            check,
            found,
            format!(
                "a cycle of {cycle:?} would have begun late: do what is said above, or choose a longer one"
            ),
        )
    }
}
