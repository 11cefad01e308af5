//! The report as a table, and as JSON.

use std::time::Duration;

use serde_json::{Value, json};
use servocrab::bus::{ClockStatistics, DevicePorts, Durations, ReferenceClock};

use super::measure::Report;
use crate::output::table;

/// The shares of the cycles that are reported.
const SHARES: [(&str, f64); 3] = [("50 %", 0.5), ("99 %", 0.99), ("99.9 %", 0.999)];

pub(crate) fn microseconds(time: Option<Duration>) -> f64 {
    time.map_or(0.0, |time| time.as_nanos() as f64 / 1e3)
}

impl Report {
    /// What was counted, with its name.
    fn counts(&self) -> Vec<(&'static str, u64)> {
        let counted = &self.counted;
        let mut counts = vec![
            ("cycles", counted.cycles),
            ("late cycles", counted.late_cycles),
            ("overruns", counted.overruns),
            ("lost frames", counted.lost),
            ("late frames", counted.late),
            ("damaged frames", counted.damaged),
            ("foreign frames", counted.foreign),
            ("wrong working counters", counted.wrong_working_counters),
            ("frames not sent", counted.not_sent),
            ("acyclic frames in a cycle", counted.acyclic_in_cycle),
        ];
        counts.extend(
            counted
                .clock
                .map(|clock| ("cycles beyond the bound", clock.beyond)),
        );
        counts
    }

    fn histograms(&self) -> impl Iterator<Item = (&'static str, &Durations)> {
        let timing = &self.timing;
        [
            ("late by", &timing.lateness),
            ("round trip", &timing.round_trip),
            ("phase error", &timing.phase_error),
        ]
        .into_iter()
        // There is no phase without distributed clocks.
        .filter(|(_, times)| times.count() > 0)
    }

    pub(crate) fn text(&self) -> String {
        let mut text = format!(
            "cycles of {:.0} µs, for {:.1} s\n\n",
            microseconds(Some(self.cycle)),
            self.lasted.as_secs_f64()
        );
        let counts = self.counts();
        let rows: Vec<_> = counts
            .iter()
            .map(|(name, count)| [(*name).to_owned(), count.to_string()])
            .collect();
        text += &table(["counted", ""], &rows);
        let rows: Vec<_> = self
            .histograms()
            .map(|(name, times)| {
                let [half, most, nearly] =
                    SHARES.map(|(_, share)| format!("{:.1}", microseconds(times.quantile(share))));
                [
                    name.to_owned(),
                    format!("{:.1}", microseconds(times.least())),
                    half,
                    most,
                    nearly,
                    format!("{:.1}", microseconds(times.most())),
                ]
            })
            .collect();
        let [half, most, nearly] = SHARES.map(|(name, _)| name);
        text.push('\n');
        text += &table(["µs", "least", half, most, nearly, "most"], &rows);
        let rows: Vec<_> = self
            .drives
            .iter()
            .map(|drive| {
                [
                    drive.drive.to_string(),
                    drive.stale_cycles.to_string(),
                    drive.undelivered_cycles.to_string(),
                ]
            })
            .collect();
        text.push('\n');
        text += &table(["drive", "stale cycles", "undelivered cycles"], &rows);
        text += &format!("\n{}\n", self.cable());
        if let Some(clock) = &self.counted.clock {
            text += &format!("{}\n", phase(clock));
        }
        match &self.ports {
            Ok(devices) => {
                for line in devices.iter().flat_map(bad_cables) {
                    text += &format!("{line}\n");
                }
            }
            Err(error) => {
                text += &format!("the error counters of the ports could not be read: {error}\n");
            }
        }
        for (at, event) in &self.events {
            text += &format!("at {:.1} s: {event}\n", at.as_secs_f64());
        }
        if self.untold > 0 {
            text += &format!("and {} more of the kind\n", self.untold);
        }
        text
    }

    /// What the frames take of the cycle on a cable.
    fn cable(&self) -> String {
        let cable = &self.cable;
        let (time, cycle) = (
            microseconds(Some(cable.time())),
            microseconds(Some(self.cycle)),
        );
        let text = format!(
            "{} frame(s) of {} bytes in all: {time:.1} µs on a cable of 100 Mbit/s, {:.0} % of the cycle",
            cable.frames,
            cable.bytes,
            time / cycle * 100.0
        );
        if cable.shortest_cycle() <= self.cycle {
            return text;
        }
        let shortest = microseconds(Some(cable.shortest_cycle()));
        format!(
            "{text}: more than the three quarters for which frames are waited for; choose {shortest:.0} µs at least, map less, or \
             divide the line"
        )
    }

    pub(crate) fn json(&self) -> Value {
        let counts: serde_json::Map<String, Value> = self
            .counts()
            .into_iter()
            .map(|(name, count)| (name.replace(' ', "_"), count.into()))
            .collect();
        let times: serde_json::Map<String, Value> = self
            .histograms()
            .map(|(name, times)| {
                let [p50, p99, p999] = SHARES.map(|(_, share)| microseconds(times.quantile(share)));
                let buckets: Vec<_> = times
                    .buckets()
                    .map(|(range, count)| json!([microseconds(Some(*range.end())), count]))
                    .collect();
                let told = json!({
                    "least_us": microseconds(times.least()),
                    "p50_us": p50,
                    "p99_us": p99,
                    "p999_us": p999,
                    "most_us": microseconds(times.most()),
                    "buckets_us": buckets,
                });
                (name.replace(' ', "_"), told)
            })
            .collect();
        let drives: Vec<_> = self
            .drives
            .iter()
            .map(|drive| {
                json!({
                    "position": drive.drive.position,
                    "name": drive.drive.name,
                    "stale_cycles": drive.stale_cycles,
                    "undelivered_cycles": drive.undelivered_cycles,
                })
            })
            .collect();
        let ports = self.ports.as_ref().map_or(Value::Null, |devices| {
            devices.iter().map(port_counters).collect()
        });
        let cable = json!({
            "frames": self.cable.frames,
            "bytes": self.cable.bytes,
            "time_us": microseconds(Some(self.cable.time())),
            "shortest_cycle_us": microseconds(Some(self.cable.shortest_cycle())),
        });
        let events: Vec<_> = self
            .events
            .iter()
            .map(|(at, event)| json!({ "at_s": at.as_secs_f64(), "event": event }))
            .collect();
        let clock = self.counted.clock.map(|clock| {
            json!({
                "bound_us": microseconds(Some(clock.bound)),
                "locked": clock.locked,
                "reference": reference(&clock),
            })
        });
        json!({
            "cycle_us": microseconds(Some(self.cycle)),
            "duration_s": self.lasted.as_secs_f64(),
            "clock": clock,
            "counts": counts,
            "times": times,
            "drives": drives,
            "ports": ports,
            "cable": cable,
            "events": events,
        })
    }
}

/// How cycles and reference clock stand to each other at the end.
fn phase(clock: &ClockStatistics) -> String {
    format!(
        "reference clock {}; the schedule {} the bound of {:.1} µs, the thread's waking aside",
        reference(clock),
        if clock.locked { "keeps" } else { "is beyond" },
        microseconds(Some(clock.bound)),
    )
}

/// What the reference clock does.
fn reference(clock: &ClockStatistics) -> &'static str {
    match clock.reference {
        ReferenceClock::Heard => "heard",
        ReferenceClock::Silent => "silent",
        ReferenceClock::Jumped => "jumped",
        _ => "in another state",
    }
}

/// A line for each port at which something is wrong. What was damaged before it came here (forwarded) is another cable's.
fn bad_cables(device: &DevicePorts) -> Vec<String> {
    let bad = device.ports.iter().enumerate().filter(|(_, errors)| {
        errors.invalid_frames > 0 || errors.physical > 0 || errors.lost_links > 0
    });
    let told = bad.map(|(port, errors)| {
        let towards = if port == 0 { ", towards the MainDevice" } else { "" };
        let full = [errors.invalid_frames, errors.physical, errors.lost_links].contains(&u8::MAX);
        format!(
            "device {}, port {port}{towards}: {} damaged frames, {} damaged symbols, link lost {} times: look at that cable, its plugs, \
             and the device at its other end{}",
            device.position,
            errors.invalid_frames,
            errors.physical,
            errors.lost_links,
            if full {
                " (255 is where a counter stops, until the device is switched off and on)"
            } else {
                ""
            }
        )
    });
    told.collect()
}

fn port_counters(device: &DevicePorts) -> Value {
    let ports = device.ports.map(|port| {
        json!({
            "invalid_frames": port.invalid_frames,
            "physical": port.physical,
            "forwarded": port.forwarded,
            "lost_links": port.lost_links,
        })
    });
    json!({
        "position": device.position,
        "ports": ports,
        "processing_unit": device.processing_unit,
        "process_data_interface": device.process_data_interface,
    })
}

#[cfg(test)]
mod tests {
    use servocrab::bus::{DevicePorts, PortErrors};

    use super::bad_cables;

    #[test]
    fn a_cable_is_told_by_frames_found_damaged_there_first_and_not_by_forwarded_ones() {
        let mut device = DevicePorts {
            position: 3,
            ports: [PortErrors::default(); 4],
            processing_unit: None,
            process_data_interface: None,
        };
        device.ports[1].forwarded = 9;
        assert!(bad_cables(&device).is_empty());
        device.ports[0].invalid_frames = 2;
        let [line] = &bad_cables(&device)[..] else {
            panic!("one cable");
        };
        assert!(
            line.starts_with("device 3, port 0, towards the MainDevice: 2 damaged frames"),
            "{line}"
        );
    }
}
