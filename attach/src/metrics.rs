//! The text for Prometheus, made anew for each scrape.

use std::{fmt, sync::atomic::AtomicU64, time::Duration};

use prometheus_client::{
    encoding::text::encode,
    metrics::{
        counter::{ConstCounter, Counter},
        family::Family,
        gauge::Gauge,
    },
    registry::Registry,
};
use servocrab::bus::{DevicePorts, Durations, NetworkView};

pub(crate) const TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

type Labels = Vec<(&'static str, String)>;
type Counters = Family<Labels, Counter>;
/// Its numbers are those of an `f64`.
type Gauges = Family<Labels, Gauge<f64, AtomicU64>>;

/// Without `ports` the text has no counters of ports: they could not be read.
pub(crate) fn text(
    view: &NetworkView,
    ports: Option<&[DevicePorts]>,
) -> Result<String, fmt::Error> {
    let mut registry = Registry::with_prefix("servocrab");
    counted(&mut registry, view);
    let timing = view.timing();
    for (name, help, times) in [
        (
            "lateness_seconds",
            "How late the cycles began, since the start",
            &timing.lateness,
        ),
        (
            "round_trip_seconds",
            "How long the frames were away, since the start",
            &timing.round_trip,
        ),
    ] {
        registry.register(name, help, quantiles(times));
    }
    drives(&mut registry, view);
    axes(&mut registry, view);
    if let Some(ports) = ports {
        registry.register(
            "port_errors",
            "Errors that the ports of the devices have counted; each stops at 255",
            errors(ports),
        );
    }
    let mut text = String::new();
    encode(&mut text, &registry)?;
    Ok(text)
}

fn counted(registry: &mut Registry, view: &NetworkView) {
    let counted = view.statistics();
    for (name, help, value) in [
        ("cycles", "Cycles of process data", counted.cycles),
        (
            "late_cycles",
            "Cycles that began more than half a cycle late",
            counted.late_cycles,
        ),
        ("overruns", "Cycles that were left out", counted.overruns),
        (
            "lost_frames",
            "Frames that did not come back within their cycle",
            counted.lost,
        ),
        (
            "late_frames",
            "Frames that came back after their time",
            counted.late,
        ),
        (
            "damaged_frames",
            "Frames that were changed on their way",
            counted.damaged,
        ),
        (
            "frames_not_sent",
            "Frames that the link did not take",
            counted.not_sent,
        ),
        (
            "wrong_working_counters",
            "Datagrams with another working counter than expected",
            counted.wrong_working_counters,
        ),
    ] {
        registry.register(name, help, ConstCounter::new(value));
    }
}

fn quantiles(times: &Durations) -> Gauges {
    let family = Gauges::default();
    for (name, time) in [
        ("0", times.least()),
        ("0.5", times.quantile(0.5)),
        ("0.99", times.quantile(0.99)),
        ("0.999", times.quantile(0.999)),
        ("1", times.most()),
    ] {
        if let Some(seconds) = time.as_ref().map(Duration::as_secs_f64) {
            let labels = vec![("quantile", name.to_owned())];
            family.get_or_create(&labels).set(seconds);
        }
    }
    family
}

fn drives(registry: &mut Registry, view: &NetworkView) {
    let [stale, undelivered, emergencies] = [(); 3].map(|()| Counters::default());
    for drive in view.drive_statistics() {
        let labels = vec![("drive", drive.drive.position.to_string())];
        stale.get_or_create(&labels).inc_by(drive.stale_cycles);
        undelivered
            .get_or_create(&labels)
            .inc_by(drive.undelivered_cycles);
        for (code, number) in drive.emergencies {
            let labels = vec![labels[0].clone(), ("code", error_code(code))];
            emergencies.get_or_create(&labels).inc_by(number);
        }
    }
    registry.register(
        "stale_cycles",
        "Cycles in which nothing came back from the drive",
        stale,
    );
    registry.register(
        "undelivered_cycles",
        "Cycles of which it is not known whether the drive got its outputs",
        undelivered,
    );
    registry.register(
        "emergencies",
        "Emergencies of the drive by their error code",
        emergencies,
    );
}

fn axes(registry: &mut Registry, view: &NetworkView) {
    let (states, lost) = (Gauges::default(), Gauges::default());
    for axis in view.axes() {
        let name = vec![("axis", axis.identity.axis.to_string())];
        let number = if axis.snapshot.lost { 1.0 } else { 0.0 };
        lost.get_or_create(&name).set(number);
        let state = vec![name[0].clone(), ("state", axis.snapshot.state.to_string())];
        states.get_or_create(&state).set(1.0);
    }
    let [motions, faults] = [(); 2].map(|()| Counters::default());
    for counted in view.axis_statistics() {
        let axis = ("axis", counted.axis.axis.to_string());
        for (end, number) in counted.motions {
            let labels = vec![axis.clone(), ("end", end.to_string())];
            motions.get_or_create(&labels).inc_by(number);
        }
        for (code, number) in counted.faults {
            let labels = vec![axis.clone(), ("code", error_code(code))];
            faults.get_or_create(&labels).inc_by(number);
        }
    }
    registry.register(
        "axis_motions",
        "Moves, homings and jogs by how they ended",
        motions,
    );
    registry.register(
        "axis_faults",
        "Faults of the axis by their error code",
        faults,
    );
    registry.register("axis_state", "1 for the state of each axis", states);
    registry.register("axis_lost", "1 for an axis that counts as lost", lost);
}

fn error_code(code: Option<u16>) -> String {
    code.map_or_else(|| "other".to_owned(), |code| format!("{code:04X}h"))
}

fn errors(ports: &[DevicePorts]) -> Counters {
    let family = Counters::default();
    for device in ports {
        for (port, errors) in device.ports.iter().enumerate() {
            for (kind, number) in [
                ("invalid_frames", errors.invalid_frames),
                ("physical", errors.physical),
                ("forwarded", errors.forwarded),
                ("lost_links", errors.lost_links),
            ] {
                let labels = vec![
                    ("device", device.position.to_string()),
                    ("port", port.to_string()),
                    ("kind", kind.to_owned()),
                ];
                family.get_or_create(&labels).inc_by(number.into());
            }
        }
    }
    family
}
