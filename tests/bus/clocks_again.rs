//! Drives that insist on outputs in time against SYNC0, and were without power: their clocks are set while those of the others run.

use std::time::Duration;

use servocrab::drives;
use servocrab::{
    DriveConfig, Network,
    bus::{DistributedClock, Recovered, ReferenceClock},
};
use servocrab::{Outcome, SetPoint};
use servocrab_sim::{AlState, Segment};

use crate::clocks::{apart, insisting, mistakes};
use crate::rig::{Line, Rig, unhomed};

const MS: Duration = Duration::from_millis(1);
const SECOND: Duration = Duration::from_secs(1);

fn named(axis: &str) -> DriveConfig {
    unhomed(drives::sigma7(), &[axis]).dc(DistributedClock::new(0x0300))
}

/// Three drives, whose crystals are so many parts per million too fast; frames take their time to the last one.
fn started(cycle: Duration, [first, second, third]: [f64; 3]) -> (Line, Rig) {
    let mut segment = Segment::new().with(insisting(cycle, first, 5_000_000_000));
    segment.push(insisting(cycle, second, 77));
    segment.push(insisting(cycle, third, 1 << 40));
    segment.set_delay(1, Duration::from_nanos(900));
    segment.set_delay(2, Duration::from_nanos(1_700));
    let line = Line::new(segment);
    let builder = Network::builder().link(line.wire()).cycle(cycle);
    let builder = builder.drive(0, named("x")).drive(1, named("y"));
    let rig = Rig::start(builder.drive(2, named("z"))).unwrap();
    (line, rig)
}

/// That nobody complains, and all show the same time, for some seconds.
fn all_agree(line: &Line, rig: &mut Rig) {
    let before = mistakes(line);
    for _ in 0..30 {
        rig.run_for(100 * MS);
        let apart = apart(&line.segment(), rig.bus.now());
        assert!(apart < 200, "{apart} ns apart");
    }
    assert_eq!(mistakes(line), before, "nobody has complained");
    let segment = line.segment();
    assert!(
        segment
            .devices()
            .iter()
            .all(|device| device.al_state() == AlState::Op)
    );
}

#[test]
fn a_drive_that_was_without_power_gets_the_time_of_the_running_line_and_nobody_else_notices() {
    for ppm in [100.0, -100.0] {
        let (line, mut rig) = started(MS, [ppm, -ppm, ppm / 2.0]);
        // Longer than the low half of the times lasts.
        rig.run_for(5 * SECOND);
        let x = rig.net().axis("x").unwrap();
        let motion = rig.until(async {
            x.enable().await.unwrap();
            let mode = x.profile_position().await.unwrap();
            mode.move_abs(100_000, SetPoint::new().velocity(10_000))
                .await
                .unwrap()
        });
        rig.loses_power(&line, 1);
        let of_x = line.segment().devices()[0].sync_mistakes();
        let recovered = rig.recover(1).unwrap();
        let from = None;
        assert_eq!(recovered, Recovered::BroughtUp { position: 1, from });
        // It was cut off meanwhile.
        assert!(matches!(
            rig.recover(2).unwrap(),
            Recovered::FromSafeOp { .. }
        ));
        rig.run_for(100 * MS);
        all_agree(&line, &mut rig);
        assert_eq!(line.segment().devices()[0].sync_mistakes(), of_x);
        let clock = rig.net().statistics().clock.unwrap();
        assert_eq!(clock.reference, ReferenceClock::Heard);
        assert!(clock.locked && clock.beyond == 0, "{clock:?}");
        let outcome = rig.until(motion.done()).unwrap();
        assert!(
            matches!(outcome, Outcome::Reached { position } if (position - 100_000).abs() <= 10),
            "{outcome:?}"
        );
        for axis in ["y", "z"] {
            // Without frames it has complained about its outputs.
            let handle = rig.net().axis(axis).unwrap();
            if handle.status().state.is_fault() {
                rig.until(handle.reset_fault()).unwrap();
            }
            let moved = rig.moved(axis, 2_000);
            assert!(
                matches!(moved, Outcome::Reached { .. }),
                "{axis}: {moved:?}"
            );
        }
        rig.shutdown();
    }
}

#[test]
fn hours_after_the_start_the_time_is_known_as_well() {
    // By then the crystals are further apart than the low half of a time can tell.
    let (line, mut rig) = started(50 * MS, [-450.0, -400.0, -500.0]);
    rig.run_for(5_000 * SECOND);
    rig.loses_power(&line, 2);
    rig.recover(2).unwrap();
    rig.run_for(SECOND);
    all_agree(&line, &mut rig);
    rig.shutdown();
}

#[test]
fn one_that_fell_to_init_with_its_clock_running_follows_again_the_reference_too() {
    let (line, mut rig) = started(MS, [50.0, -50.0, 0.0]);
    for position in [0, 1] {
        let mut segment = line.segment();
        segment
            .device_mut(position)
            .unwrap()
            .fall_to(AlState::Init, 0x8001);
        drop(segment);
        rig.run_for(200 * MS);
        let recovered = rig.recover(position as u16).unwrap();
        assert!(matches!(recovered, Recovered::BroughtUp { .. }));
        rig.run_for(100 * MS);
        all_agree(&line, &mut rig);
    }
    rig.shutdown();
}
