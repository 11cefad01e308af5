//! The heading, "Description", "Drive Opmode", "Motion Settings", "Common PDO Data", "CANopen Scaling" and the first rows
//! of the example.

use servocrab::SetPoint;
use servocrab::coe::{AnyObject, AxisOffset, Object, ObjectAddress, ReadWrite, obj};
use servocrab::drives;
use servocrab::ds402::{Mode, SupportedModes};
use servocrab::pdo_map::{Direction, Mapping as PdoMapping};
use servocrab::units::{Factors, Ratio, Scale};
use servocrab::{
    Failure,
    axis::{AxisCore, AxisFields, Command, Completion, CoreConfig, Inputs, Unsupported},
};
use servocrab_sim::ds402::{Access, Behaviour, DataType, FollowingError, Mapping, State};
use servocrab_sim::personality;

use crate::bench::{ACCELERATION, DECELERATION, Drive, VELOCITY, assert_near};
use crate::common::Rig;
use crate::wire::Wire;

const UNKNOWN_OBJECT: u32 = 0x0602_0000;

pub(super) fn akd2g() -> Drive {
    Drive::enabled(Behaviour::akd2g())
}

#[test]
pub(super) fn drive_each_axis_has_its_own_mode_object() {
    let mut wire = Wire::new(personality::akd2g());
    wire.download(0x6060, 0, &[0]).expect("axis 1");
    wire.download(0x6860, 0, &[1]).expect("axis 2");
    wire.run(5);
    assert_eq!(wire.upload(0x6861, 0), Ok(vec![1]));
    assert_eq!(wire.upload(0x6061, 0), Ok(vec![0]));
    assert_eq!(wire.download(0x7060, 0, &[1]), Err(UNKNOWN_OBJECT));
}

#[test]
pub(super) fn library_each_axis_has_its_own_mode_object() {
    let layout = drives::akd2g().default_mapping().expect("it").layout();
    for (axis, index) in [(1, 0x6060), (2, 0x6860)] {
        let place = layout.find(Direction::Outputs, index, 0).expect("mapped");
        let fields = AxisFields::from_layout(&layout, AxisOffset::of_axis(axis)).expect("all");
        let mut core = AxisCore::new(CoreConfig::new(fields));
        let mut outputs = vec![0; layout.output_bytes()];
        core.step(
            core::time::Duration::from_millis(1),
            Inputs::Stale,
            &mut outputs,
        );
        assert_eq!(outputs[place.byte], 1, "axis {axis}");
        let written = outputs.iter().filter(|byte| **byte != 0).count();
        assert_eq!(
            written, 2,
            "axis {axis} writes its controlword too, and nothing of the other"
        );
    }
}

#[test]
pub(super) fn drive_has_the_mode_and_coe() {
    let mut wire = Wire::new(personality::akd2g());
    let mailbox = wire.line.segment().devices()[0].description().mailbox;
    assert_eq!(mailbox.expect("a mailbox").protocols & 0x04, 0x04, "CoE");
    for index in [0x6502, 0x6D02] {
        let modes = wire.upload(index, 0).expect("supported drive modes");
        assert_eq!(modes[0] & 1, 1, "{index:04X}h");
    }
}

#[test]
pub(super) fn library_reads_the_mode_from_6502h() {
    let held = Drive::new(Behaviour::akd2g()).get(0x6502);
    let held = u32::try_from(held).expect("32 bits");
    for (modes, allowed) in [(held, true), (held & !1, false)] {
        let mut rig = Rig::new(Behaviour::akd2g(), |config| {
            config.mode = Mode::Homing;
            config.supported_modes = Some(SupportedModes::from_bits_retain(modes));
        })
        .ideal();
        rig.enable();
        let mode = Mode::ProfilePosition;
        let select = rig.send(Command::SelectMode(mode));
        let expected = if allowed {
            Ok(Completion::Done)
        } else {
            Err(Failure::Unsupported(Unsupported::Mode(mode)))
        };
        assert_eq!(rig.finish(select), expected, "{modes:08X}h");
        assert_eq!(rig.mode() == mode, allowed);
    }
    // What the library writes before a drive's first cycle, by CoE over EtherCAT.
    let mut wire = Wire::new(personality::akd2g());
    let mapping = drives::akd2g().default_mapping().expect("a mapping");
    for step in mapping.plan().steps() {
        let ObjectAddress { index, subindex } = step.object;
        assert_eq!(
            wire.download(index, subindex, step.value()),
            Ok(()),
            "{step}"
        );
    }
}

#[test]
pub(super) fn drive_goes_from_rest_to_rest() {
    let mut drive = akd2g();
    drive.start(0x0F, 20_000);
    drive.run(1);
    assert!(drive.axis.velocity() <= 200.0, "from rest");
    drive.run_until(5_000, |drive| drive.bit(10));
    assert_eq!(drive.axis.position(), 20_000);
    assert_eq!(drive.axis.velocity(), 0.0, "to rest");
    assert!(!drive.moves());
}

#[test]
pub(super) fn library_reports_the_arrival_at_rest() {
    let mut rig = Rig::ideal_enabled();
    for target in [20_000, -5_000] {
        rig.drive.disturbances().stale_reached_cycles = 20;
        let id = rig.abs(target, SetPoint::new());
        assert_eq!(
            rig.finish(id),
            Ok(Completion::Reached { position: target }),
            "and not with what bit 10 was before"
        );
        assert_eq!(rig.drive.velocity(), 0.0);
    }
}

#[test]
pub(super) fn drive_takes_the_profile_from_objects() {
    let mut drive = akd2g();
    drive.set(0x6081, 4_000);
    drive.set(0x6083, 40_000);
    drive.set(0x6084, 80_000);
    drive.start(0x0F, 3_000);
    drive.run(300);
    assert_near(drive.axis.velocity(), 4_000.0);
    drive.settle();
    let line = &drive.axis.ledger()[0];
    assert_eq!(
        (
            line.value,
            line.velocity,
            line.acceleration,
            line.deceleration
        ),
        (3_000, 4_000, 40_000, 80_000)
    );
}

#[test]
pub(super) fn library_sends_the_profile_with_the_set_point() {
    let mut rig = Rig::ideal_enabled();
    for n in 1..=3 {
        let target = 3_000 * i32::try_from(n).expect("small");
        let set_point = SetPoint::new()
            .velocity(4_000 * n)
            .acceleration(40_000 * n)
            .deceleration(80_000 * n);
        let id = rig.abs(target, set_point);
        assert!(rig.finish(id).is_ok());
        let line = rig.ledger().last().expect("it was executed");
        assert_eq!(
            (
                line.value,
                line.velocity,
                line.acceleration,
                line.deceleration
            ),
            (target, 4_000 * n, 40_000 * n, 80_000 * n)
        );
    }
}

#[test]
pub(super) fn drive_needs_nothing_but_6060h_for_the_mode() {
    let mut drive = Drive::powered_up(Behaviour::akd2g());
    assert_eq!(drive.get(0x6061), 0);
    drive.enable();
    drive.start(0x0F, 5_000);
    assert!(!drive.moves(), "no mode, no move");
    assert!(drive.outcomes().is_empty());
    drive.set(0x6060, 1);
    drive.lower();
    assert_eq!(drive.get(0x6061), 1);
    drive.word(0x1F);
    drive.settle();
    assert_eq!(drive.axis.position(), 5_000);
    assert_eq!(drive.outcomes().len(), 1);
}

#[test]
pub(super) fn library_moves_only_once_the_mode_is_shown() {
    let behaviour = Behaviour {
        mode_change_cycles: 200,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::new(behaviour, |_| {}).ideal();
    rig.enable();
    let early = rig.abs(5_000, SetPoint::new());
    assert!(matches!(
        rig.outcome(early),
        Some(Err(Failure::WrongMode { .. }))
    ));
    rig.run_until(300, |rig| rig.mode() == Mode::ProfilePosition);
    let id = rig.abs(5_000, SetPoint::new());
    assert_eq!(rig.finish(id), Ok(Completion::Reached { position: 5_000 }));
}

#[test]
pub(super) fn drive_cruises_at_6081h() {
    let mut drive = akd2g();
    drive.start(0x0F, 20_000);
    drive.run(500);
    assert_near(drive.axis.velocity(), VELOCITY as f64);
    drive.lower();
    drive.set(0x6081, 2 * VELOCITY);
    drive.start(0x2F, 40_000);
    drive.run(500);
    assert_near(drive.axis.velocity(), 2.0 * VELOCITY as f64);
}

#[test]
pub(super) fn library_puts_the_velocity_into_6081h() {
    let mut rig = Rig::ideal_enabled();
    let id = rig.abs(20_000, SetPoint::new().velocity(12_345));
    rig.wait_accepted(id);
    assert_eq!(rig.drive.get(0x6081, 0), Some(12_345));
    rig.run(1_000);
    assert_near(rig.drive.velocity(), 12_345.0);
}

#[test]
pub(super) fn drive_speeds_up_by_6083h() {
    let mut drive = akd2g();
    drive.start(0x0F, 20_000);
    drive.run(50);
    assert_near(drive.axis.velocity(), ACCELERATION as f64 * 0.05);
}

#[test]
pub(super) fn library_puts_the_acceleration_into_6083h() {
    let mut rig = Rig::ideal_enabled();
    let id = rig.abs(20_000, SetPoint::new().acceleration(60_000));
    rig.wait_accepted(id);
    assert_eq!(rig.drive.get(0x6083, 0), Some(60_000));
    assert_eq!(rig.drive.get(0x6084, 0), Some(500_000));
}

#[test]
pub(super) fn drive_slows_down_by_6084h() {
    let mut drive = akd2g();
    drive.start(0x0F, 20_000);
    // From 10 000 counts/s to rest at 50 000 counts/s²: the last 1 000 counts, half the speed after three quarters.
    drive.run_until(5_000, |drive| drive.axis.position() >= 18_900);
    assert_near(drive.axis.velocity(), VELOCITY as f64);
    drive.run_until(5_000, |drive| drive.axis.position() >= 19_750);
    assert_near(
        drive.axis.velocity(),
        (2.0 * DECELERATION as f64 * 250.0).sqrt(),
    );
}

#[test]
pub(super) fn library_puts_the_deceleration_into_6084h() {
    let mut rig = Rig::ideal_enabled();
    let id = rig.abs(20_000, SetPoint::new().deceleration(70_000));
    rig.wait_accepted(id);
    assert_eq!(rig.drive.get(0x6084, 0), Some(70_000));
    assert_eq!(rig.drive.get(0x6083, 0), Some(500_000));
}

/// What the document lists as data of RxPDOs.
const WRITTEN: [(u16, DataType); 5] = [
    (0x607A, DataType::I32),
    (0x6081, DataType::U32),
    (0x6083, DataType::U32),
    (0x6084, DataType::U32),
    (0x6040, DataType::U16),
];
/// And of TxPDOs, but for 605Ah and 5000h.
const READ: [(u16, DataType); 4] = [
    (0x6041, DataType::U16),
    (0x6063, DataType::I32),
    (0x6064, DataType::I32),
    (0x606C, DataType::I32),
];

/// A mapping entry of both axes' object.
fn entries(objects: &[(u16, DataType)]) -> Vec<u32> {
    let entry = |&(index, kind): &(u16, DataType), axis: u16| {
        let bits = u32::try_from(kind.size() * 8).expect("few");
        u32::from(index + 0x0800 * axis) << 16 | bits
    };
    let of = |axis| objects.iter().map(move |object| entry(object, axis));
    of(0).chain(of(1)).collect()
}

#[test]
pub(super) fn drive_maps_the_written_objects() {
    let drive = Drive::new(Behaviour::akd2g());
    for (index, kind) in WRITTEN {
        let (is, access, mapping) = drive.attributes(index, 0);
        assert_eq!((is, access), (kind, Access::ReadWrite), "{index:04X}h");
        assert!(matches!(mapping, Mapping::Rx | Mapping::Both));
    }
    let mut wire = Wire::new(personality::akd2g());
    assert_eq!(wire.map(0x1C12, 0x1600, &entries(&WRITTEN)), Ok(()));
}

#[test]
pub(super) fn library_maps_the_written_objects() {
    let objects: [(AnyObject, usize); 5] = [
        (obj::TARGET_POSITION.into(), 4),
        (obj::PROFILE_VELOCITY.into(), 4),
        (obj::PROFILE_ACCELERATION.into(), 4),
        (obj::PROFILE_DECELERATION.into(), 4),
        (obj::CONTROLWORD.into(), 2),
    ];
    for axis in [1, 2] {
        let mut builder = PdoMapping::builder()
            .offset(AxisOffset::of_axis(axis))
            .rx_pdo(0x1600);
        for (object, _) in objects {
            builder = builder.object(Direction::Outputs, object);
        }
        let layout = builder.build().expect("a mapping").layout();
        let mut at = 0;
        for ((_, bytes), (index, kind)) in objects.into_iter().zip(WRITTEN) {
            let index = index + 0x0800 * (u16::from(axis) - 1);
            let place = layout.find(Direction::Outputs, index, 0).expect("mapped");
            assert_eq!(
                (place.byte, usize::from(place.bits)),
                (at, 8 * kind.size()),
                "{index:04X}h"
            );
            at += bytes;
        }
    }
}

#[test]
pub(super) fn drive_maps_the_read_objects() {
    let drive = Drive::new(Behaviour::akd2g());
    for (index, kind) in READ {
        let (is, access, mapping) = drive.attributes(index, 0);
        assert_eq!((is, access), (kind, Access::ReadOnly), "{index:04X}h");
        assert!(matches!(mapping, Mapping::Tx | Mapping::Both));
    }
    let mut wire = Wire::new(personality::akd2g());
    assert_eq!(wire.map(0x1C13, 0x1A00, &entries(&READ)), Ok(()));
}

#[test]
pub(super) fn library_maps_the_read_objects() {
    let objects: [AnyObject; 4] = [
        obj::STATUSWORD.into(),
        obj::POSITION_ACTUAL_INTERNAL.into(),
        obj::POSITION_ACTUAL.into(),
        obj::VELOCITY_ACTUAL.into(),
    ];
    for axis in [1, 2] {
        let mut builder = PdoMapping::builder()
            .offset(AxisOffset::of_axis(axis))
            .tx_pdo(0x1A00);
        for object in objects {
            builder = builder.object(Direction::Inputs, object);
        }
        let layout = builder.build().expect("a mapping").layout();
        let mut at = 0;
        for (index, kind) in READ {
            let index = index + 0x0800 * (u16::from(axis) - 1);
            let place = layout.find(Direction::Inputs, index, 0).expect("mapped");
            assert_eq!(
                (place.byte, usize::from(place.bits)),
                (at, 8 * kind.size()),
                "{index:04X}h"
            );
            at += kind.size();
        }
    }
}

#[test]
pub(super) fn drive_maps_the_quick_stop_option() {
    let (kind, access, _) = Drive::new(Behaviour::akd2g()).attributes(0x605A, 0);
    assert_eq!((kind, access), (DataType::I16, Access::ReadWrite));
    let mut wire = Wire::new(personality::akd2g());
    assert_eq!(
        wire.map(0x1C13, 0x1A00, &[0x605A_0010, 0x685A_0010]),
        Ok(())
    );
}

#[test]
pub(super) fn library_maps_the_quick_stop_option() {
    // It can be written, by its type.
    let option: Object<i16, ReadWrite> = obj::QUICK_STOP_OPTION;
    for (axis, index) in [(1, 0x605A), (2, 0x685A)] {
        let layout = PdoMapping::builder()
            .offset(AxisOffset::of_axis(axis))
            .tx_pdo(0x1A00)
            .input(option)
            .build()
            .expect("a mapping")
            .layout();
        let place = layout.find(Direction::Inputs, index, 0).expect("mapped");
        assert_eq!((place.byte, place.bits), (0, 16), "{index:04X}h");
    }
}

#[test]
pub(super) fn drive_has_a_motion_status_for_each_axis() {
    let mut wire = Wire::new(personality::akd2g());
    for index in [0x5000, 0x5100] {
        assert_eq!(wire.upload(index, 4).expect("it is there").len(), 4);
        assert!(wire.download(index, 4, &[0; 4]).is_err(), "read only");
    }
    assert_eq!(
        wire.map(0x1C13, 0x1A00, &[0x5000_0420, 0x5100_0420]),
        Ok(())
    );
}

#[test]
pub(super) fn library_has_a_motion_status_for_each_axis() {
    for (axis, index) in [(1, 0x5000), (2, 0x5100)] {
        let layout = PdoMapping::builder()
            .offset(AxisOffset::of_axis(axis))
            .tx_pdo(0x1A00)
            .input(obj::AKD2G_MOTION_STATUS)
            .build()
            .expect("a mapping")
            .layout();
        let place = layout.find(Direction::Inputs, index, 4).expect("mapped");
        assert_eq!(place.bits, 32);
    }
}

#[test]
pub(super) fn drive_is_moved_and_led_by_the_same_word() {
    let mut drive = Drive::new(Behaviour::akd2g());
    assert_eq!(drive.word(0x06) & 0x6F, 0x21);
    assert_eq!(drive.word(0x07) & 0x6F, 0x23);
    assert_eq!(drive.word(0x0F) & 0x6F, 0x27);
    drive.set(0x607A, 20_000);
    assert_eq!(drive.word(0x1F) & 0x6F, 0x27, "bit 4 changes no state");
    assert!(drive.moves());
    drive.word(0x07);
    drive.settle();
    assert_eq!(drive.state(), State::SwitchedOn, "the state ends the move");
    assert!(drive.axis.position() < 20_000);
}

#[test]
pub(super) fn library_steps_through_the_states_before_a_move() {
    let behaviour = Behaviour {
        power_on_cycles: 30,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::new(behaviour, |_| {}).ideal();
    rig.enable();
    let id = rig.abs(5_000, SetPoint::new());
    assert!(rig.finish(id).is_ok());
    assert_eq!(
        rig.distinct_words(1),
        [0x0B, 0x00, 0x06, 0x07, 0x0F, 0x2F, 0x3F, 0x0F],
        "each word once, after the state that it starts from"
    );
    let switched_on = rig.words.iter().filter(|word| **word == 0x0F).count();
    assert!(switched_on > 30);
}

#[test]
pub(super) fn drive_starts_only_in_operation_enabled() {
    let mut drive = Drive::new(Behaviour::akd2g());
    drive.set(0x607A, 20_000);
    for (word, state) in [
        (0x00, State::SwitchOnDisabled),
        (0x06, State::ReadyToSwitchOn),
        (0x07, State::SwitchedOn),
    ] {
        drive.word(word);
        drive.word(word | 0x10);
        assert_eq!(drive.state(), state);
        assert!(!drive.bit(12));
        assert!(!drive.moves());
    }
    drive.word(0x1F);
    assert_eq!(drive.state(), State::OperationEnabled);
    assert!(!drive.moves(), "bit 4 rose before");
    assert!(drive.outcomes().is_empty());
}

#[test]
pub(super) fn library_refuses_a_move_before_operation_is_enabled() {
    let mut rig = Rig::akd2g().ideal();
    rig.run(5);
    let id = rig.abs(5_000, SetPoint::new());
    assert!(matches!(
        rig.outcome(id),
        Some(Err(Failure::NotEnabled { .. }))
    ));
    rig.enable();
    rig.run(100);
    assert!(rig.words.iter().all(|word| word & 0x10 == 0));
    assert!(rig.ledger().is_empty());
}

#[test]
pub(super) fn drive_keeps_a_profile_from_another_state() {
    let mut drive = Drive::new(Behaviour::akd2g());
    assert_eq!(drive.state(), State::SwitchOnDisabled);
    drive.set(0x607A, 3_000);
    drive.set(0x6081, 4_000);
    drive.enable();
    assert!(!drive.moves(), "a definition is no command");
    drive.word(0x1F);
    drive.run(300);
    assert_near(drive.axis.velocity(), 4_000.0);
    drive.settle();
    assert_eq!(drive.axis.position(), 3_000);
}

#[test]
pub(super) fn library_shows_the_position_as_target_in_other_states() {
    let behaviour = Behaviour {
        mode_change_cycles: 100,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::new(behaviour, |_| {}).ideal();
    rig.run(5);
    rig.drive.place(777);
    rig.run(5);
    assert_eq!(rig.drive.get(0x607A, 0), Some(777), "no jump can follow");
    rig.enable();
    assert_eq!(rig.drive.position(), 777);
}

#[test]
pub(super) fn drive_scales_between_6063h_and_6064h() {
    let mut drive = akd2g();
    // 1 000 user units for a turn of 2²⁰ increments.
    drive.set_sub(0x6092, 1, 1_000);
    drive.start(0x0F, 2_500);
    drive.settle();
    drive.run(1);
    assert_eq!(drive.get(0x6064), 2_500);
    assert_eq!(drive.get(0x6063), 2_500 * (1 << 20) / 1_000);
}

#[test]
pub(super) fn library_scales_between_units_and_counts() {
    let drive = akd2g();
    let factors = |feed: i64| Factors {
        encoder: Ratio::new(1 << 20, 1).ok(),
        feed: Ratio::new(feed.unsigned_abs(), 1).ok(),
        ..Factors::default()
    };
    assert_eq!(drive.axis.get(0x6092, 1), Some(1 << 20));
    // A spindle of 5 mm, 1 000 position units a turn: 200 to a millimetre.
    let scale = factors(1_000).scale(Ratio::new(5, 1).expect("5 mm"));
    let scale = scale.expect("a scale");
    let counts = scale.position(12.503).expect("in range");
    assert_eq!(counts, 2_501, "the nearest");
    let mut rig = Rig::ideal_enabled();
    rig.drive.set(0x6092, 1, 1_000).expect("the feed constant");
    let id = rig.abs(counts, SetPoint::new());
    assert!(rig.finish(id).is_ok());
    rig.run(1);
    let increments = rig.drive.get(0x6063, 0).expect("6063h");
    assert_eq!(increments, 2_501 * (1 << 20) / 1_000);
    assert!((scale.position_of(rig.core.snapshot().position) - 12.505).abs() < 1e-9);
}

#[test]
pub(super) fn drive_means_another_speed_once_a_factor_has_changed() {
    let mut drive = akd2g();
    drive.set(0x6081, 6_000);
    drive.start(0x0F, 20_000);
    drive.run(500);
    assert_near(drive.axis.velocity(), 6_000.0);
    drive.lower();
    // Two units for one count/s: the same number is half the speed.
    drive.set_sub(0x6096, 1, 2);
    assert_eq!(drive.get(0x6081), 6_000, "the number stays");
    drive.start(0x2F, 20_000);
    drive.run(500);
    assert_near(drive.axis.velocity(), 3_000.0);
}

/// 1 000 counts a revolution, two units for a count/s, and so many units for two of these units/s.
fn scaled_by(acceleration: u64) -> Scale {
    let factors = Factors {
        feed: Ratio::new(1_000, 1).ok(),
        velocity: Ratio::new(2, 1).ok(),
        acceleration: Ratio::new(acceleration, 1).ok(),
        ..Factors::default()
    };
    factors.scale(Ratio::ONE).expect("a scale")
}

#[test]
pub(super) fn library_counts_a_velocity_by_its_factor() {
    let scale = scaled_by(1);
    assert_eq!(scale.position(3.0), Ok(3_000));
    let velocity = scale.velocity(3.0).expect("in range");
    assert_eq!(velocity, 6_000, "two units for a count/s");
    let mut rig = Rig::ideal_enabled();
    rig.drive.set(0x6096, 1, 2).expect("the velocity factor");
    let id = rig.abs(30_000, SetPoint::new().velocity(velocity));
    rig.wait_accepted(id);
    assert_eq!(rig.drive.get(0x6081, 0), Some(6_000));
    rig.run(500);
    assert_near(rig.drive.velocity(), 3_000.0);
    assert!((scale.velocity_of(rig.drive.get(0x606C, 0).expect("606Ch")) - 3.0).abs() < 0.1);
}

#[test]
pub(super) fn drive_means_another_ramp_once_a_factor_has_changed() {
    for (index, factor, velocity) in [
        (0x6096, 1, 3_000.0),
        (0x6097, 1, 3_000.0),
        (0x6097, 2, 1_500.0),
    ] {
        let mut drive = akd2g();
        drive.set_sub(index, 1, factor);
        assert_eq!(drive.get(0x6083), ACCELERATION, "the number stays");
        drive.start(0x0F, 20_000);
        drive.run(29);
        assert_near(drive.axis.velocity(), velocity);
        // The ramp down, at half the deceleration as well.
        drive.run_until(5_000, |drive| drive.axis.position() > 15_000);
        assert_near(drive.axis.velocity(), VELOCITY as f64);
        drive.word(0x11F);
        drive.run(99);
        assert_near(
            drive.axis.velocity(),
            VELOCITY as f64 - 5_000.0 / factor as f64,
        );
    }
}

#[test]
pub(super) fn library_counts_a_ramp_by_its_factor() {
    // 3 revolutions/s² are 3 000 counts/s², twice that in units of velocity/s, five times that in units of acceleration.
    let scale = scaled_by(5);
    let acceleration = scale.acceleration(3.0).expect("in range");
    assert_eq!(acceleration, 30_000);
    let mut rig = Rig::ideal_enabled();
    rig.drive.set(0x6096, 1, 2).expect("the velocity factor");
    rig.drive
        .set(0x6097, 1, 5)
        .expect("the acceleration factor");
    let set_point = SetPoint::new()
        .acceleration(acceleration)
        .deceleration(acceleration);
    let id = rig.abs(30_000, set_point);
    rig.wait_accepted(id);
    let before = rig.drive.velocity();
    rig.run(500);
    assert_near(rig.drive.velocity() - before, 1_500.0);
}

#[test]
pub(super) fn drive_obeys_the_first_rows_of_the_example() {
    let mut drive = Drive::powered_up(Behaviour::akd2g());
    drive.set(0x6060, 0x01);
    for (object, value) in [
        (0x607A, 20_000),
        (0x6081, 10_000),
        (0x6083, 100_000),
        (0x6084, 50_000),
    ] {
        drive.set(object, value);
        assert_eq!(drive.get(object), value);
    }
    drive.word(0x06);
    assert_eq!(drive.state(), State::ReadyToSwitchOn);
    assert_eq!(drive.get(0x6061), 1);
    drive.word(0x0F);
    drive.word(0x0F);
    assert_eq!(
        drive.state(),
        State::OperationEnabled,
        "0Fh switches on and enables"
    );
    assert!(!drive.moves());
}

#[test]
pub(super) fn library_does_the_first_rows_of_the_example_in_their_order() {
    let mut rig = Rig::akd2g().ideal();
    rig.enable();
    // Quick stop until the state was seen for two of the drive's cycles. 07h is CiA 402's own step between 06h and 0Fh.
    assert_eq!(rig.distinct_words(1), [0x0B, 0x00, 0x06, 0x07, 0x0F]);
    assert_eq!(rig.outputs[2], 1, "6060h is written before, and all along");
    assert_eq!(rig.mode(), Mode::ProfilePosition);
    // Target and parameters come after these words, in the frame of bit 4 at the latest.
    let held = |rig: &Rig| [0x607A, 0x6081, 0x6083, 0x6084].map(|index| rig.drive.get(index, 0));
    assert_eq!(held(&rig)[0], Some(0));
    let set_point = SetPoint::new()
        .velocity(10_000)
        .acceleration(100_000)
        .deceleration(60_000);
    let id = rig.abs(20_000, set_point);
    while rig.words.last().is_none_or(|word| word & 0x10 == 0) {
        assert_eq!(rig.outcome(id), None);
        rig.cycle();
    }
    let data = [20_000, 10_000, 100_000, 60_000];
    assert_eq!(held(&rig), data.map(Some));
}

#[test]
pub(super) fn drive_shows_what_the_monitor_rows_read() {
    let mut drive = akd2g();
    drive.start(0x0F, 5_000);
    let seen = [12, 13, 10].map(|bit| drive.bit(bit));
    assert_eq!(seen, [true, false, false]);
    drive.settle();
    drive.lower();
    let seen = [12, 13, 10].map(|bit| drive.bit(bit));
    assert_eq!(seen, [false, false, true]);
    assert_eq!((drive.get(0x6063), drive.get(0x6064)), (5_000, 5_000));
}

#[test]
pub(super) fn library_passes_on_what_the_monitor_rows_read() {
    let mut description = drives::akd2g();
    description.axes.truncate(1);
    let internal = obj::POSITION_ACTUAL_INTERNAL;
    description.axes[0].inputs.push(internal.into());
    let layout = description.default_mapping().expect("a mapping").layout();
    let internal = layout.input(internal).expect("mapped");
    let behaviour = Behaviour {
        following_error: FollowingError::BitOnly,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::of(description, behaviour, |_| {}).ideal();
    rig.enable();
    let id = rig.abs(5_000, SetPoint::new());
    // Bits 12, 13 and 10, each time that one of them changes.
    let mut seen: Vec<[bool; 3]> = Vec::new();
    while rig.outcome(id).is_none() {
        let inputs = rig.inputs();
        rig.cycle();
        let snapshot = rig.core.snapshot();
        let bits = [12, 13, 10].map(|bit| snapshot.statusword.bits() >> bit & 1 == 1);
        if seen.last() != Some(&bits) {
            seen.push(bits);
        }
        let position = internal.read(&inputs).expect("as long as the image");
        assert_eq!(position, snapshot.position, "6063h and 6064h, unscaled");
    }
    let progress = [[true, false, false], [false; 3], [false, false, true]];
    assert_eq!(seen[seen.len() - 3..], progress);
    assert_eq!(rig.core.snapshot().position, 5_000);
    rig.drive.set(0x6065, 0, 500).expect("the window");
    rig.drive.disturbances().blocked = true;
    rig.abs(500_000, SetPoint::new());
    rig.run(1_000);
    let word = rig.core.snapshot().statusword;
    assert_eq!(word.bits() >> 13 & 1, 1, "following error: {word:?}");
}
