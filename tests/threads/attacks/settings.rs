//! Settings that cannot be meant are refused where they are declared, and none of them stops the bus thread.

use std::time::Duration;

use servocrab::{
    DriveConfig, NetworkError,
    axis::{Deadlines, Tolerances},
    bus::{NetworkBuilder, WaitStrategy},
    drives,
};

use super::{line, started};

const HOUR: Duration = Duration::from_secs(3600);

/// The setting that is refused, if one is.
fn refused(builder: NetworkBuilder) -> Option<&'static str> {
    match builder.split() {
        Ok(_) => None,
        Err(NetworkError::Setting(error)) => {
            let text = error.to_string();
            assert!(
                text.contains(error.setting) && text.contains("at most"),
                "{text}"
            );
            Some(error.setting)
        }
        Err(error) => panic!("{error}"),
    }
}

fn with_axis(change: impl FnOnce(DriveConfig) -> DriveConfig) -> Option<&'static str> {
    let drive = DriveConfig::new(drives::akd2g()).axis("second").axis("y");
    refused(line().1.drive(1, change(drive)))
}

#[test]
fn every_deadline_is_checked_where_it_is_declared() {
    type Field = fn(&mut Deadlines) -> &mut Duration;
    let fields: [(&str, Field); 7] = [
        ("deadline `enable`", |all| &mut all.enable),
        ("deadline `disable`", |all| &mut all.disable),
        ("deadline `acknowledge`", |all| &mut all.acknowledge),
        ("deadline `begin`", |all| &mut all.begin),
        ("deadline `standstill`", |all| &mut all.standstill),
        ("deadline `mode`", |all| &mut all.mode),
        ("deadline `fault_reset`", |all| &mut all.fault_reset),
    ];
    for (name, field) in fields {
        for (time, wrong) in [
            (Duration::MAX, true),
            (HOUR + Duration::from_nanos(1), true),
            (Duration::ZERO, true),
            (HOUR, false),
            (Duration::from_millis(1), false),
        ] {
            let mut deadlines = Deadlines::default();
            *field(&mut deadlines) = time;
            let refused =
                with_axis(|drive| drive.change_axis("second", |axis| axis.deadlines(deadlines)));
            assert_eq!(refused, wrong.then_some(name), "{time:?}");
        }
    }
}

#[test]
fn every_other_time_is_checked_where_it_is_declared() {
    let tolerances = Tolerances {
        settle: Duration::MAX,
        ..Tolerances::default()
    };
    let refused_settle =
        with_axis(|drive| drive.change_axis("y", |axis| axis.tolerances(tolerances)));
    assert_eq!(refused_settle, Some("settle time"));
    for time in [Duration::ZERO, Duration::MAX] {
        assert_eq!(refused(line().1.cycle(time)), Some("cycle"));
        assert_eq!(refused(line().1.watchdog(time)), Some("watchdog"));
    }
}

#[test]
fn the_cycle_of_a_drive_in_a_program_s_own_description_is_checked_where_it_is_declared() {
    for (time, wrong) in [
        (Duration::ZERO, true),
        (Duration::from_micros(1), false),
        (Duration::from_secs(1), false),
        (Duration::from_nanos(1_000_000_001), true),
        (Duration::MAX, true),
    ] {
        let mut description = drives::akd2g();
        description.traits.drive_cycle = time;
        let drive = DriveConfig::new(description).axis("second");
        let expected = wrong.then_some("drive cycle of its traits");
        assert_eq!(refused(line().1.drive(1, drive)), expected, "{time:?}");
    }
}

#[test]
fn the_time_of_a_liveness_is_checked_where_it_is_asked_for() {
    let (_segment, net) = started();
    for time in [Duration::ZERO, Duration::from_micros(999), Duration::MAX] {
        let error = net.liveness(time).unwrap_err();
        assert_eq!((error.setting, error.got), ("time of `liveness`", time));
    }
    for time in [Duration::from_millis(1), HOUR] {
        net.liveness(time).unwrap().end();
    }
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn a_thread_that_is_to_spin_for_ever_goes_on() {
    let spin = Duration::MAX;
    smol::block_on(async {
        let builder = line().1.wait_strategy(WaitStrategy::SpinThenBlock { spin });
        let net = builder.start().await.unwrap();
        for _ in 0..20 {
            net.clock().next_cycle().await.unwrap();
        }
        net.shutdown().await.unwrap();
    });
}
