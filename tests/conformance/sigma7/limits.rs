//! "Target Position", "Software Position Limits" and "Max Profile Velocity": what they do.

use servocrab::ds402::Mode;
use servocrab::{
    BufferMode, SetPoint,
    profile_position::{Limits, PositionRange},
};
use servocrab::{
    Failure, Referencing,
    axis::{Command, CommandId, Completion},
};
use servocrab::{HomingMethod, homing::HomingCommand};
use servocrab_sim::ds402::{Behaviour, Machine, State};

use crate::bench::{Drive, VELOCITY, assert_near};
use crate::common::Rig;

/// A Sigma-7 with an absolute encoder, limits from -5 000 to 8 000, and this home offset.
fn limited(home_offset: i64) -> Drive {
    let mut drive = Drive::new(with_encoder(0));
    drive.set_sub(0x607D, 1, -5_000);
    drive.set_sub(0x607D, 2, 8_000);
    drive.set(0x607C, home_offset);
    drive.enable();
    drive
}

fn with_encoder(start: i64) -> Behaviour {
    Behaviour {
        machine: Machine {
            start,
            absolute_encoder: true,
            ..Machine::default()
        },
        ..Behaviour::sigma7()
    }
}

/// Where a target outside leads.
fn ends_at(drive: &mut Drive, word: u16, target: i64) -> i64 {
    drive.start(word, target);
    drive.settle();
    drive.axis.position()
}

/// The library's limits of the same drive.
fn library_limits(home_offset: i32) -> Limits {
    Limits {
        software: Some(PositionRange {
            min: -5_000,
            max: 8_000,
        }),
        home_offset,
        ..Limits::trust_drive()
    }
}

/// The library on a drive with an absolute encoder that holds the same limits as it.
fn rig(limits: Limits) -> Rig {
    let mut rig = Rig::of(servocrab::drives::sigma7(), with_encoder(0), |config| {
        config.referencing = Referencing::AbsoluteEncoder;
        config.limits = limits;
    })
    .ideal();
    if let Some(PositionRange { min, max }) = limits.software {
        rig.drive.set(0x607D, 1, min.into()).expect("the minimum");
        rig.drive.set(0x607D, 2, max.into()).expect("the maximum");
    }
    let offset = limits.home_offset.into();
    rig.drive.set(0x607C, 0, offset).expect("the home offset");
    rig.enable();
    rig
}

fn is_refused(rig: &Rig, id: CommandId, at: i64) -> bool {
    matches!(
        rig.outcome(id),
        Some(Err(Failure::BeyondLimit { limit, .. })) if limit == at
    )
}

#[test]
pub(super) fn drive_takes_607ah_as_the_target_of_profile_position() {
    let mut drive = Drive::enabled(Behaviour::sigma7());
    drive.set(0x607A, 3_000);
    assert!(!drive.moves());
    drive.word(0x3F);
    drive.settle();
    assert_eq!(drive.axis.position(), 3_000);
}

#[test]
pub(super) fn library_writes_the_target_into_607ah() {
    let mut rig = rig(Limits::trust_drive());
    let id = rig.abs(3_000, SetPoint::new());
    rig.wait_accepted(id);
    assert_eq!(rig.drive.get(0x607A, 0), Some(3_000));
    assert_eq!(rig.finish(id), Ok(Completion::Reached { position: 3_000 }));
}

#[test]
pub(super) fn drive_takes_607ah_as_position_or_distance() {
    let mut drive = Drive::enabled(Behaviour::sigma7());
    for (word, end) in [(0x2F, 3_000), (0x6F, 6_000), (0x2F, 3_000)] {
        assert_eq!(ends_at(&mut drive, word, 3_000), end, "{word:02X}h");
    }
}

#[test]
pub(super) fn library_says_whether_607ah_is_position_or_distance() {
    let mut rig = rig(Limits::trust_drive());
    let id = rig.abs(3_000, SetPoint::new());
    assert!(rig.finish(id).is_ok());
    let id = rig.rel(3_000, SetPoint::new());
    assert_eq!(rig.finish(id), Ok(Completion::Reached { position: 6_000 }));
    let relative: Vec<_> = rig.ledger().iter().map(|line| line.relative).collect();
    assert_eq!(relative, [false, true]);
}

#[test]
pub(super) fn drive_keeps_its_demand_within_the_limits() {
    let mut drive = limited(0);
    for target in [20_000, -20_000] {
        drive.start(0x2F, target);
        for _ in 0..3_000 {
            drive.run(1);
            let demand = drive.get(0x6062);
            assert!((-5_000..=8_000).contains(&demand), "{demand}");
        }
    }
    assert!(drive.bit(11), "internal limit active");
}

#[test]
pub(super) fn library_refuses_a_target_beyond_the_limits() {
    let mut rig = rig(library_limits(0));
    for (target, limit) in [(8_001, 8_000), (-5_001, -5_000)] {
        let refused = rig.abs(target, SetPoint::new());
        assert!(is_refused(&rig, refused, limit), "{target}");
    }
    rig.run(50);
    assert!(rig.ledger().is_empty(), "nothing was sent");
    let id = rig.abs(8_000, SetPoint::new());
    assert_eq!(rig.finish(id), Ok(Completion::Reached { position: 8_000 }));
}

#[test]
pub(super) fn drive_checks_every_target() {
    let mut drive = limited(0);
    assert_eq!(ends_at(&mut drive, 0x2F, 9_000), 8_000, "replacing");
    assert_eq!(ends_at(&mut drive, 0x0F, -9_000), -5_000, "queued");
    assert_eq!(ends_at(&mut drive, 0x6F, -1_000), -5_000, "relative");
    assert_eq!(ends_at(&mut drive, 0x4F, 50_000), 8_000, "relative, queued");
    assert_eq!(ends_at(&mut drive, 0x2F, 7_000), 7_000, "within");
}

#[test]
pub(super) fn library_checks_every_target_that_it_knows() {
    let mut rig = rig(library_limits(0));
    for start in [
        BufferMode::Aborting,
        BufferMode::Buffered,
        BufferMode::Blending,
    ] {
        let refused = rig.abs(9_000, SetPoint::new().buffer_mode(start));
        assert!(is_refused(&rig, refused, 8_000), "{start:?}");
    }
    // The base of the first distance is not documented: it is checked from where the axis stands.
    let refused = rig.rel(8_001, SetPoint::new());
    rig.run(5);
    assert!(is_refused(&rig, refused, 8_000));
    assert!(rig.ledger().is_empty());
    let id = rig.rel(8_000, SetPoint::new());
    assert_eq!(rig.finish(id), Ok(Completion::Reached { position: 8_000 }));
    assert_eq!(rig.drive.position(), 8_000);
}

/// An incremental drive at 3 000 of its machine, with a limit switch at its zero: homed by it, its zero is there.
fn at_3_000() -> Behaviour {
    Behaviour {
        machine: Machine {
            start: 3_000,
            negative_limit: Some(0),
            ..Machine::default()
        },
        ..Behaviour::sigma7()
    }
}

/// Homing by the negative limit switch.
const HOMING: [(u16, u8, i64); 4] = [
    (0x6098, 0, 17),
    (0x6099, 1, 10_000),
    (0x6099, 2, 2_000),
    (0x609A, 0, 200_000),
];

fn home(drive: &mut Drive) {
    for (index, subindex, value) in HOMING {
        drive.set_sub(index, subindex, value);
    }
    drive.set(0x6060, 6);
    drive.word(0x0F);
    drive.word(0x1F);
    drive.run_until(5_000, |drive| drive.bit(12) && drive.bit(10));
    drive.set(0x6060, 1);
    drive.word(0x0F);
    drive.run(3);
}

#[test]
pub(super) fn drive_counts_the_limits_from_the_home_position() {
    let mut drive = Drive::new(at_3_000());
    drive.set_sub(0x607D, 1, -500);
    drive.set_sub(0x607D, 2, 6_000);
    drive.enable();
    home(&mut drive);
    let shift = drive.axis.mechanical_position() - drive.axis.position();
    assert_eq!(ends_at(&mut drive, 0x2F, 50_000), 6_000);
    assert_eq!(
        drive.axis.mechanical_position(),
        6_000 + shift,
        "6 000 from the machine's home"
    );
    assert!(shift.abs() <= 1, "home is at the switch: {shift}");
}

#[test]
pub(super) fn drive_corrects_the_minimum_by_the_home_offset() {
    for offset in [1_000, -1_000] {
        let mut drive = limited(offset);
        assert_eq!(ends_at(&mut drive, 0x2F, -50_000), -5_000 - offset);
    }
}

#[test]
pub(super) fn library_corrects_the_minimum_by_the_home_offset() {
    for offset in [1_000, -1_000] {
        let mut rig = rig(library_limits(offset));
        let limit = -5_000 - offset;
        let refused = rig.abs(limit - 1, SetPoint::new());
        assert!(is_refused(&rig, refused, limit.into()), "{offset}");
        let id = rig.abs(limit, SetPoint::new());
        assert_eq!(rig.finish(id), Ok(Completion::Reached { position: limit }));
    }
}

#[test]
pub(super) fn drive_corrects_the_maximum_by_the_home_offset() {
    for offset in [1_000, -1_000] {
        let mut drive = limited(offset);
        assert_eq!(ends_at(&mut drive, 0x2F, 50_000), 8_000 - offset);
    }
}

#[test]
pub(super) fn library_corrects_the_maximum_by_the_home_offset() {
    for offset in [1_000, -1_000] {
        let mut rig = rig(library_limits(offset));
        let limit = 8_000 - offset;
        let refused = rig.abs(limit + 1, SetPoint::new());
        assert!(is_refused(&rig, refused, limit.into()), "{offset}");
        let id = rig.abs(limit, SetPoint::new());
        assert_eq!(rig.finish(id), Ok(Completion::Reached { position: limit }));
    }
}

#[test]
pub(super) fn drive_compares_targets_with_the_corrected_limits() {
    let mut drive = limited(1_000);
    assert_eq!(ends_at(&mut drive, 0x2F, 7_000), 7_000, "at the limit");
    assert!(!drive.bit(11));
    assert_eq!(ends_at(&mut drive, 0x2F, 7_500), 7_000, "between the two");
    assert!(drive.bit(11));
    assert_eq!(ends_at(&mut drive, 0x2F, -5_500), -5_500);
    assert!(!drive.bit(11));
}

#[test]
pub(super) fn library_compares_targets_with_the_corrected_limits() {
    let mut rig = rig(library_limits(1_000));
    let refused = rig.abs(7_500, SetPoint::new());
    assert!(is_refused(&rig, refused, 7_000));
    let id = rig.abs(-5_500, SetPoint::new());
    assert_eq!(rig.finish(id), Ok(Completion::Reached { position: -5_500 }));
}

#[test]
pub(super) fn drive_has_limits_once_it_is_homed() {
    let mut drive = Drive::new(at_3_000());
    drive.set_sub(0x607D, 1, -500);
    drive.set_sub(0x607D, 2, 2_000);
    drive.enable();
    assert_eq!(ends_at(&mut drive, 0x2F, 5_000), 5_000, "not homed yet");
    home(&mut drive);
    assert_eq!(ends_at(&mut drive, 0x2F, 5_000), 2_000);
    drive.axis = drive.axis.restarted();
    drive.run(5);
    drive.set(0x6060, 1);
    drive.set_sub(0x607D, 1, -500);
    drive.set_sub(0x607D, 2, 2_000);
    drive.enable();
    assert_eq!(ends_at(&mut drive, 0x2F, 5_000), 5_000, "homed no longer");
}

#[test]
pub(super) fn library_has_limits_once_the_axis_is_homed() {
    let mut rig = Rig::of(servocrab::drives::sigma7(), at_3_000(), |config| {
        config.limits = library_limits(0);
    })
    .ideal();
    for (index, subindex, value) in HOMING {
        rig.drive.set(index, subindex, value).expect("it takes it");
    }
    rig.enable();
    let id = rig.abs(9_000, SetPoint::new());
    assert_eq!(rig.finish(id), Ok(Completion::Reached { position: 9_000 }));
    let select = rig.send(Command::SelectMode(Mode::Homing));
    assert!(rig.finish(select).is_ok());
    let homing = rig.send(Command::Home(HomingCommand {
        method: HomingMethod::NEGATIVE_LIMIT,
        offset: None,
        until: None,
    }));
    assert!(rig.finish(homing).is_ok(), "{:?}", rig.outcome(homing));
    let select = rig.send(Command::SelectMode(Mode::ProfilePosition));
    assert!(rig.finish(select).is_ok());
    let refused = rig.abs(9_000, SetPoint::new());
    assert!(is_refused(&rig, refused, 8_000));
}

#[test]
pub(super) fn drive_has_limits_with_an_absolute_encoder() {
    let mut drive = Drive::new(with_encoder(1_000));
    drive.set_sub(0x607D, 1, -500);
    drive.set_sub(0x607D, 2, 2_000);
    drive.enable();
    assert_eq!(drive.axis.position(), 1_000);
    assert_eq!(ends_at(&mut drive, 0x2F, 5_000), 2_000, "from power-up on");
    assert_eq!(drive.state(), State::OperationEnabled);
}

#[test]
pub(super) fn library_has_limits_with_an_absolute_encoder() {
    for (referencing, refuses) in [
        (Referencing::AbsoluteEncoder, true),
        (Referencing::UnreferencedMovesAllowed, false),
    ] {
        let mut rig = Rig::of(servocrab::drives::sigma7(), Behaviour::sigma7(), |config| {
            config.referencing = referencing;
            config.limits = library_limits(0);
        })
        .ideal();
        rig.enable();
        let id = rig.abs(9_000, SetPoint::new());
        assert_eq!(is_refused(&rig, id, 8_000), refuses, "{referencing:?}");
    }
}

#[test]
pub(super) fn drive_has_no_limits_where_min_is_not_below_max() {
    for (min, max) in [(0, 0), (2_000, 2_000), (3_000, -3_000)] {
        let mut drive = Drive::new(with_encoder(0));
        drive.set_sub(0x607D, 1, min);
        drive.set_sub(0x607D, 2, max);
        drive.enable();
        assert_eq!(ends_at(&mut drive, 0x2F, 9_000), 9_000, "{min} {max}");
        assert_eq!(ends_at(&mut drive, 0x2F, -9_000), -9_000, "{min} {max}");
    }
}

#[test]
pub(super) fn library_has_no_limits_where_min_is_not_below_max() {
    for (min, max) in [(0, 0), (2_000, 2_000), (3_000, -3_000)] {
        let mut rig = rig(Limits {
            software: Some(PositionRange { min, max }),
            ..Limits::trust_drive()
        });
        let id = rig.abs(9_000, SetPoint::new());
        assert_eq!(
            rig.finish(id),
            Ok(Completion::Reached { position: 9_000 }),
            "{min} {max}"
        );
    }
}

#[test]
pub(super) fn drive_moves_no_faster_than_607fh() {
    let mut drive = Drive::enabled(Behaviour::sigma7());
    drive.set(0x607F, VELOCITY / 2);
    drive.start(0x2F, 20_000);
    drive.run(500);
    assert_near(drive.axis.velocity(), VELOCITY as f64 / 2.0);
}

#[test]
pub(super) fn library_asks_for_no_more_than_607fh() {
    let mut rig = rig(Limits {
        max_velocity: Some(20_000),
        ..Limits::trust_drive()
    });
    let refused = rig.abs(5_000, SetPoint::new().velocity(20_001));
    assert!(matches!(
        rig.outcome(refused),
        Some(Err(Failure::BeyondLimit { limit: 20_000, .. }))
    ));
    rig.run(50);
    assert!(rig.ledger().is_empty());
    let id = rig.abs(5_000, SetPoint::new().velocity(20_000));
    assert!(rig.finish(id).is_ok());
}
