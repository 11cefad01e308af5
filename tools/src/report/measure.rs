//! What is measured, in parts of the time.

use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use servocrab::{
    Network,
    bus::{CableLoad, DevicePorts, DriveStatistics, NetworkEvent, Statistics, Timing},
};

use crate::output::{Failure, Tool};

/// Events that are reported; a loose cable makes many.
const MOST_EVENTS: usize = 50;

/// What was measured.
pub(crate) struct Report {
    pub(crate) counted: Statistics,
    pub(crate) timing: Timing,
    pub(crate) cable: CableLoad,
    pub(crate) cycle: Duration,
    /// How long it was measured.
    pub(crate) lasted: Duration,
    pub(crate) drives: Vec<DriveStatistics>,
    /// What the ports counted during the measurement, or why that is not known.
    pub(crate) ports: Result<Vec<DevicePorts>, String>,
    pub(crate) intervals: Vec<Interval>,
    /// What happened to drives, and when.
    pub(crate) events: Vec<(Duration, String)>,
    /// How many more things happened than are reported.
    pub(crate) untold: usize,
}

/// A part of the time.
pub(crate) struct Interval {
    /// When it ended, since the begin of the measurement.
    pub(crate) until: Duration,
    pub(crate) timing: Timing,
    /// Frames that did not come back, or were not sent.
    pub(crate) lost: u64,
}

/// Measures for this time, or until Ctrl-C.
pub(crate) async fn measure(
    tool: &Tool,
    net: &Network,
    time: Duration,
    cycle: Duration,
) -> Result<Report, Failure> {
    let every = (time / 200).max(Duration::from_millis(20));
    let bar = ProgressBar::new(time.as_millis().try_into()?).with_style(
        ProgressStyle::with_template("measuring {bar:40} {eta}  {msg}")?,
    );
    let ports = net.port_errors().await;
    let drives = net.drive_statistics();
    let happens = net.events();
    let (start, begun) = ((net.statistics(), net.timing()), Instant::now());
    let mut before = start.clone();
    let (mut intervals, mut events, mut untold) = (Vec::new(), Vec::new(), 0);
    while begun.elapsed() < time && !tool.is_interrupted() {
        smol::Timer::after(every).await;
        let now = (net.statistics(), net.timing());
        let counted = counted_since(&now.0, &before.0);
        intervals.push(Interval {
            until: begun.elapsed(),
            timing: timing_since(&now.1, &before.1),
            lost: counted.lost + counted.not_sent,
        });
        before = now;
        bar.set_position(begun.elapsed().as_millis().try_into()?);
        bar.set_message(format!("{} cycles", before.1.lateness.count()));
        while let Some(event) = happens.try_next() {
            if matches!(event, NetworkEvent::AxisIncident(_)) {
                continue;
            }
            if events.len() < MOST_EVENTS {
                events.push((begun.elapsed(), event.to_string()));
            } else {
                untold += 1;
            }
        }
    }
    let lasted = begun.elapsed();
    bar.finish_and_clear();
    let drives = net.drive_statistics().into_iter().zip(drives);
    let drives = drives.map(|(mut drive, before)| {
        drive.stale_cycles -= before.stale_cycles;
        drive.undelivered_cycles -= before.undelivered_cycles;
        drive
    });
    // A line that has fallen silent reports nothing of its ports: everything else is reported all the same.
    let ports = match (ports, net.port_errors().await) {
        (Ok(before), Ok(now)) => Ok(ports_since(now, &before)),
        (Err(error), _) | (_, Err(error)) => Err(error.to_string()),
    };
    Ok(Report {
        counted: counted_since(&before.0, &start.0),
        timing: timing_since(&before.1, &start.1),
        cable: net.cable_load(),
        cycle,
        lasted,
        drives: drives.collect(),
        ports,
        intervals,
        events,
        untold,
    })
}

fn timing_since(now: &Timing, before: &Timing) -> Timing {
    let mut since = now.clone();
    since.lateness = now.lateness.since(&before.lateness);
    since.round_trip = now.round_trip.since(&before.round_trip);
    since.phase_error = now.phase_error.since(&before.phase_error);
    since
}

fn counted_since(now: &Statistics, before: &Statistics) -> Statistics {
    let mut since = *now;
    since.cycles -= before.cycles;
    since.lost -= before.lost;
    since.late -= before.late;
    since.damaged -= before.damaged;
    since.foreign -= before.foreign;
    since.wrong_working_counters -= before.wrong_working_counters;
    since.late_cycles -= before.late_cycles;
    since.overruns -= before.overruns;
    since.not_sent -= before.not_sent;
    since.acyclic_in_cycle -= before.acyclic_in_cycle;
    if let (Some(clock), Some(before)) = (&mut since.clock, &before.clock) {
        clock.beyond -= before.beyond;
    }
    since.wakes.slow -= before.wakes.slow;
    since.wakes.panicked -= before.wakes.panicked;
    since
}

/// What each device has counted meanwhile. One that does not answer any more is not among them.
fn ports_since(now: Vec<DevicePorts>, before: &[DevicePorts]) -> Vec<DevicePorts> {
    now.into_iter()
        .map(|mut now| {
            // By its place in the line: others may have gone.
            let before = before.iter().find(|before| before.position == now.position);
            if let Some(before) = before {
                for (now, before) in now.ports.iter_mut().zip(&before.ports) {
                    now.invalid_frames = count_since(now.invalid_frames, before.invalid_frames);
                    now.physical = count_since(now.physical, before.physical);
                    now.forwarded = count_since(now.forwarded, before.forwarded);
                    now.lost_links = count_since(now.lost_links, before.lost_links);
                }
                now.processing_unit = now
                    .processing_unit
                    .map(|now| count_since(now, before.processing_unit.unwrap_or(0)));
                now.process_data_interface = now
                    .process_data_interface
                    .map(|now| count_since(now, before.process_data_interface.unwrap_or(0)));
            }
            now
        })
        .collect()
}

/// The counter of a device that was switched off and on begins anew. One that stands at 255 counts no further, so that any recent
/// error may be in it.
fn count_since(now: u8, before: u8) -> u8 {
    if now == u8::MAX {
        now
    } else {
        now.checked_sub(before).unwrap_or(now)
    }
}

#[cfg(test)]
mod tests {
    use servocrab::bus::PortErrors;

    use super::{DevicePorts, ports_since};

    fn device(position: u16, physical: u8) -> DevicePorts {
        let mut port = PortErrors::default();
        port.physical = physical;
        DevicePorts {
            position,
            ports: [port; 4],
            processing_unit: Some(physical),
            process_data_interface: None,
        }
    }

    #[test]
    fn a_device_that_is_gone_does_not_give_its_errors_to_the_next() {
        let before = [device(0, 1), device(1, 200), device(2, 7)];
        let told = ports_since(vec![device(0, 1), device(2, 9)], &before);
        assert_eq!(told, [device(0, 0), device(2, 2)]);
    }

    #[test]
    fn a_device_that_was_switched_off_counts_from_there_and_a_full_counter_is_told() {
        let before = [device(0, 100), device(1, 255)];
        let told = ports_since(vec![device(0, 3), device(1, 255)], &before);
        assert_eq!(told, [device(0, 3), device(1, 255)]);
    }
}
