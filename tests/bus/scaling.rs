//! Scale factors: written before what they scale, and compared with the scale of the program.

use std::time::Duration;

use servocrab::{
    Axis, AxisConfig, DriveConfig, Failure, Network, NetworkError, Outcome, Referencing, SetPoint,
    bus::{DriveFault, Recovered},
    coe::{Object, ObjectAddress, ReadWrite, obj},
    drives,
    parameters::{ParameterSet, StartUpList, StartUpWrite, Transition},
    units::{Mm, Ratio, Scale, ScaleDifference, ScaleMismatch, ScaleQuantity},
};
use servocrab_sim::{
    AlState, PlainEntry, PlainObject, Segment,
    ds402::{Access, DataType, Entry, FactorChange, Mapping},
    personality::{self, Servo},
};

use crate::{
    bring_up_costs::asking_wire,
    log::{Log, count},
    rig::{Line, Rig, akd2g},
};

const MS: Duration = Duration::from_millis(1);
/// Increments of the encoder in a revolution of the shaft, of which the simulated drive has as many position units at power-up.
const TURN: i64 = 1 << 20;

/// A drive that reads and writes all numbers through its factors: what was written before a factor is another number after it.
fn drive() -> Servo {
    Servo::akd2g().change(|behaviour| behaviour.factor_change = FactorChange::Numbers)
}

fn line() -> Line {
    Line::ideal(Segment::new().with(drive().build()))
}

fn start(line: &Line, drive: DriveConfig) -> Result<Rig, NetworkError> {
    Rig::start(Network::builder().link(line.wire()).drive(0, drive))
}

fn value(line: &Line, axis: usize, index: u16, subindex: u8) -> i64 {
    let segment = line.segment();
    segment.axis(0, axis).unwrap().get(index, subindex).unwrap()
}

fn set(line: &Line, index: u16, subindex: u8, value: i64) {
    let mut segment = line.segment();
    let axis = segment.axis_mut(0, 0).unwrap();
    axis.set(index, subindex, value).unwrap();
}

fn ratio(numerator: u64, denominator: u64) -> Ratio {
    Ratio::new(numerator, denominator).unwrap()
}

fn write(object: Object<u32, ReadWrite>, value: u32) -> StartUpWrite {
    StartUpWrite::new(object, value).verified()
}

/// Moves the axis by its handle, with the velocity and ramps that the drive holds.
fn moves(rig: &mut Rig, axis: &Axis, target: i32) -> Result<Outcome, Option<Failure>> {
    rig.until(async {
        axis.enable().await.unwrap();
        let mode = axis.profile_position().await.unwrap();
        let outcome = async { mode.move_abs(target, SetPoint::new()).await?.done().await };
        let outcome = outcome.await.map_err(|error| error.failure());
        mode.release().await.unwrap();
        outcome
    })
}

// --- The order of start-up lines ---

/// Limits, a velocity and ramps in units of which a revolution has 10 000, and two of a velocity in a unit/s.
fn values() -> StartUpList {
    StartUpList::new()
        .write(StartUpWrite::new(obj::SOFTWARE_LIMIT_MIN, -20_000))
        .write(StartUpWrite::new(obj::SOFTWARE_LIMIT_MAX, 20_000))
        .write(StartUpWrite::new(obj::PROFILE_VELOCITY, 50_000))
        .write(StartUpWrite::new(obj::PROFILE_ACCELERATION, 500_000))
        .write(StartUpWrite::new(obj::PROFILE_DECELERATION, 400_000))
}

fn factors() -> StartUpList {
    StartUpList::new()
        .write(write(obj::FEED, 10_000))
        .write(write(obj::VELOCITY_FACTOR_NUMERATOR, 2))
}

/// One and a half revolutions and no more, as fast as the start-up line says; and the limits are those of the lines.
fn moves_as_declared(line: &Line, rig: &mut Rig) {
    let axis = rig.net().axis("x").unwrap();
    let outcome = moves(rig, &axis, 15_000);
    assert!(
        matches!(outcome, Ok(Outcome::Reached { position: 15_000 })),
        "{outcome:?}"
    );
    rig.run_for(2 * MS);
    assert_eq!(value(line, 0, 0x6063, 0), TURN * 3 / 2);
    let executed = line.segment().axis(0, 0).unwrap().ledger().to_vec();
    let last = executed.last().unwrap();
    assert_eq!(
        (last.velocity, last.acceleration, last.deceleration),
        (50_000, 500_000, 400_000)
    );
    let beyond = moves(rig, &axis, 20_001);
    assert!(
        matches!(
            beyond,
            Err(Some(Failure::BeyondLimit { limit: 20_000, .. }))
        ),
        "{beyond:?}"
    );
}

#[test]
fn scaling_that_is_declared_last_scales_the_first_move_its_limits_and_its_velocity() {
    for lists in [
        [values(), factors()],
        [factors(), values()],
        [
            // One list, the factors between.
            values().write(write(obj::FEED, 10_000)),
            factors(),
        ],
    ] {
        let line = line();
        let [first, second] = lists;
        let mut rig = start(&line, akd2g().start_up(first).start_up(second)).unwrap();
        moves_as_declared(&line, &mut rig);
        rig.shutdown();
    }
}

#[test]
fn scaling_that_is_declared_last_goes_first_after_a_recovery_too() {
    let line = line();
    let drive = akd2g().start_up(values()).start_up(factors());
    let mut rig = start(&line, drive).unwrap();
    rig.loses_power(&line, 0);
    assert_eq!(value(&line, 0, 0x6092, 1), TURN, "it has forgotten");
    let recovered = rig.recover(0).unwrap();
    assert!(matches!(recovered, Recovered::BroughtUp { .. }));
    moves_as_declared(&line, &mut rig);
    rig.shutdown();
}

/// A maker's object, such as one that unlocks the factors.
fn own() -> PlainObject {
    PlainObject {
        index: 0x2400,
        name: "unlock".into(),
        is_array: false,
        entries: vec![PlainEntry {
            subindex: 0,
            name: "unlock".into(),
            // UNSIGNED32 (ETG.1000.6).
            data_type: 0x07,
            bytes: 4,
            varies: false,
            default: Some(vec![0; 4]),
            readable: true,
            writable: true,
            outputs: false,
            inputs: false,
        }],
    }
}

#[test]
fn lines_that_scaling_does_not_scale_stay_where_they_are_declared() {
    let line = Line::new(Segment::new().with(drive().object(own()).build()));
    let (wire, asked) = asking_wire(&line);
    let lines: [(u16, u8); 8] = [
        (0x6083, 0),
        (0x2400, 0),
        (0x6892, 1),
        (0x6085, 0),
        (0x2400, 0),
        (0x6091, 1),
        (0x6885, 0),
        (0x2400, 0),
    ];
    let drive = lines.iter().fold(akd2g(), |drive, (index, subindex)| {
        let object = ObjectAddress::new(*index, *subindex);
        drive.start_up(StartUpWrite::to(object, 2_000_000_u32))
    });
    let rig = Rig::start(Network::builder().link(wire).drive(0, drive)).unwrap();
    let asked = asked.lock().unwrap().clone();
    let is_line = |object| lines.contains(&object);
    let written = asked
        .iter()
        .filter(|one| one.writes && is_line((one.index, one.subindex)));
    assert_eq!(
        written.map(|one| one.index).collect::<Vec<_>>(),
        [
            0x2400, 0x6892, 0x2400, 0x6091, 0x6083, 0x6085, 0x6885, 0x2400
        ]
    );
    rig.shutdown();
}

#[test]
fn scaling_in_safeop_is_refused_before_anything_is_sent() {
    let line = line();
    for index in [0x607E, 0x608F, 0x6091, 0x6092, 0x6097, 0x6896, 0x68A8] {
        let scaling = StartUpWrite::to(ObjectAddress::new(index, 1), 2_u32);
        let list = values().write(scaling.at(Transition::SafeOpToOp));
        let Err(error) = start(&line, akd2g().start_up(list)) else {
            panic!("it came up with {index:04X}h");
        };
        let text = error.to_string();
        for part in ["line 6 of 6", &format!("{index:04X}h"), "at PREOP-SAFEOP"] {
            assert!(text.contains(part), "{part} is not in: {text}");
        }
    }
    assert_eq!(line.segment().devices()[0].al_state(), AlState::Init);
}

#[test]
fn a_set_of_parameters_is_restored_with_its_scaling_first() {
    let line = line();
    let mut rig = start(&line, akd2g()).unwrap();
    let sdo = rig.net().sdo(0).unwrap();
    let set = ParameterSet::from_toml(
        "[[parameter]]\nobject = \"607Dh:01\"\ntype = \"i32\"\nvalue = -20000\n\
         [[parameter]]\nobject = \"6085h:00\"\ntype = \"u32\"\nvalue = 500000\n\
         [[parameter]]\nobject = \"6092h:01\"\ntype = \"u32\"\nvalue = 10000\n",
        "x.toml",
    )
    .unwrap();
    let restored = rig.until(set.restore(&sdo, servocrab::parameters::Progress::none()));
    assert_eq!(restored.unwrap().written.len(), 3);
    assert_eq!(value(&line, 0, 0x607D, 1), -20_000);
    assert_eq!(value(&line, 0, 0x6085, 0), 500_000);
    rig.shutdown();
}

// --- The declared scale and the drive's ---

/// A slide that counts micrometres, with 5 mm a revolution.
fn slide(mismatch: ScaleMismatch) -> AxisConfig {
    AxisConfig::new("x")
        .referencing(Referencing::UnreferencedMovesAllowed)
        .unit::<Mm>(Scale::counts_per_unit(ratio(1000, 1)))
        .units_per_revolution(ratio(5, 1))
        .scale_mismatch(mismatch)
}

fn with(axis: AxisConfig) -> DriveConfig {
    DriveConfig::new(drives::akd2g()).axis(axis)
}

/// The axis, the difference and the whole message.
fn disagrees(error: NetworkError) -> (String, ScaleDifference, String) {
    let text = error.to_string();
    let NetworkError::Drive { error, .. } = error else {
        panic!("another error: {text}");
    };
    let DriveFault::Scale { axis, difference } = *error else {
        panic!("another fault: {text}");
    };
    (axis, difference, text)
}

/// 5 mm, which are a revolution of the shaft, with the velocity of a start-up line.
fn moves_a_revolution(line: &Line, rig: &mut Rig) {
    let axis = rig.net().axis_in::<Mm>("x").unwrap();
    let outcome = rig.until(async {
        axis.enable().await.unwrap();
        let mode = axis.profile_position().await.unwrap();
        let motion = mode.move_abs(5.0, SetPoint::new()).await.unwrap();
        let outcome = motion.done().await.unwrap();
        mode.release().await.unwrap();
        outcome
    });
    assert_eq!(outcome, Outcome::Reached { position: 5.0 });
    rig.run_for(2 * MS);
    assert_eq!(value(line, 0, 0x6063, 0), TURN);
    let executed = line.segment().axis(0, 0).unwrap().ledger().to_vec();
    assert_eq!(executed.last().unwrap().velocity, 20_000);
}

#[test]
fn a_scale_that_contradicts_the_drive_is_refused_with_axis_object_expected_and_got() {
    let line = line();
    let drive = with(AxisConfig::new("w")).axis(slide(ScaleMismatch::default()));
    let (axis, difference, text) = disagrees(start(&line, drive).err().unwrap());
    assert_eq!(axis, "x");
    assert_eq!(difference.object, ObjectAddress::new(0x6892, 1));
    assert_eq!(
        (difference.quantity, difference.expected, difference.got),
        (
            ScaleQuantity::PositionUnitsPerRevolution,
            5_000.0,
            TURN as f64
        )
    );
    for part in [
        "drive 0 \"",
        "axis x",
        "6892h:01: expected 5000 position units in a revolution of the shaft, got 1048576",
        "scale_mismatch",
    ] {
        assert!(text.contains(part), "{part} is not in: {text}");
    }
    // Nothing has enabled it, and nothing has moved.
    let segment = line.segment();
    assert!(segment.axis(0, 1).unwrap().ledger().is_empty());
}

#[test]
fn a_scale_that_agrees_comes_up_and_moves_the_distance() {
    let line = line();
    let drive = with(slide(ScaleMismatch::Refuse))
        .start_up(StartUpWrite::new(obj::PROFILE_VELOCITY, 20_000))
        .start_up(write(obj::FEED, 5_000));
    let mut rig = start(&line, drive).unwrap();
    moves_a_revolution(&line, &mut rig);
    rig.shutdown();
}

#[test]
fn velocities_that_contradict_the_drive_are_refused_though_no_revolution_is_declared() {
    for (factor, index) in [
        (obj::VELOCITY_FACTOR_NUMERATOR, 0x6096),
        (obj::ACCELERATION_FACTOR_DIVISOR, 0x6097),
    ] {
        let in_mm = |scale| {
            let axis = AxisConfig::new("x").unit::<Mm>(scale);
            with(axis).start_up(write(factor, 2))
        };
        let plain = Scale::counts_per_unit(ratio(1000, 1));
        let (_, difference, _) = disagrees(start(&line(), in_mm(plain)).err().unwrap());
        assert_eq!(difference.object, ObjectAddress::new(index, 1));
        let right = match index {
            0x6096 => plain
                .velocity_counts_per_unit(ratio(2000, 1))
                .acceleration_counts_per_unit(ratio(2000, 1)),
            _ => plain.acceleration_counts_per_unit(ratio(500, 1)),
        };
        start(&line(), in_mm(right)).unwrap().shutdown();
        // In counts nothing is declared.
        let counts = with(AxisConfig::new("x")).start_up(write(factor, 2));
        start(&line(), counts).unwrap().shutdown();
    }
}

#[test]
fn an_object_that_is_missing_says_nothing() {
    let line = Line::new(Segment::new().with(personality::pp2010()));
    let axis = slide(ScaleMismatch::Refuse);
    start(&line, DriveConfig::new(drives::pp2010()).axis(axis))
        .unwrap()
        .shutdown();
}

/// 60A8h: 10 to the power of its first byte, metres.
static MICROMETRES: [Entry; 1] = [Entry::new(
    (0x60A8, 0),
    DataType::U32,
    Access::ReadWrite,
    Mapping::None,
    "SI unit position",
)
.default(0xFA01_0000)];

#[test]
fn a_length_that_contradicts_the_si_unit_of_the_drive_is_refused() {
    let device = || {
        let device = Servo::generic().change(|behaviour| behaviour.own_objects = &MICROMETRES);
        Line::new(Segment::new().with(device.build()))
    };
    let in_mm = |counts| {
        let scale = Scale::counts_per_unit(ratio(counts, 1));
        DriveConfig::new(drives::generic()).axis(AxisConfig::new("x").unit::<Mm>(scale))
    };
    start(&device(), in_mm(1_000)).unwrap().shutdown();
    let (_, difference, _) = disagrees(start(&device(), in_mm(500)).err().unwrap());
    assert_eq!(difference.object, ObjectAddress::new(0x60A8, 0));
    assert_eq!(difference.quantity, ScaleQuantity::PositionUnitsPerMetre);
}

#[test]
fn a_difference_that_is_accepted_is_a_warning_at_the_start_and_at_each_recovery() {
    let log = Log::begin();
    let line = line();
    let mut rig = start(&line, with(slide(ScaleMismatch::Warn))).unwrap();
    let parts = ["WARN", "6092h:01: expected 5000", "got 1048576"];
    rig.run_for(2 * MS);
    assert_eq!(count(&log.take(), &parts), 1);
    rig.loses_power(&line, 0);
    rig.recover(0).unwrap();
    rig.run_for(2 * MS);
    assert_eq!(count(&log.take(), &parts), 1);
    assert_eq!(value(&line, 0, 0x6092, 1), TURN, "the drive is left alone");
    rig.shutdown();
}

#[test]
fn a_scale_that_is_written_is_there_before_what_it_scales_and_again_after_a_recovery() {
    let line = line();
    let scale = Scale::counts_per_unit(ratio(1000, 1))
        .velocity_counts_per_unit(ratio(4000, 1))
        .acceleration_counts_per_unit(ratio(2000, 1));
    let axis = slide(ScaleMismatch::Write).unit::<Mm>(scale);
    let drive = with(axis)
        .start_up(StartUpWrite::new(obj::PROFILE_VELOCITY, 20_000))
        .start_up(StartUpWrite::new(obj::SOFTWARE_LIMIT_MAX, 6_000))
        .start_up(StartUpWrite::new(obj::SOFTWARE_LIMIT_MIN, -6_000));
    let mut rig = start(&line, drive).unwrap();
    for again in [false, true] {
        if again {
            rig.loses_power(&line, 0);
            assert_eq!(value(&line, 0, 0x6092, 1), TURN, "it has forgotten");
            rig.recover(0).unwrap();
        }
        let held = |index, subindex| value(&line, 0, index, subindex);
        assert_eq!((held(0x6092, 1), held(0x6092, 2)), (5_000, 1));
        assert_eq!((held(0x6096, 1), held(0x6096, 2)), (4, 1));
        assert_eq!((held(0x6097, 1), held(0x6097, 2)), (1, 2));
        assert_eq!(held(0x607D, 2), 6_000);
        moves_a_revolution(&line, &mut rig);
    }
    rig.shutdown();
}

#[test]
fn what_cannot_be_written_is_refused() {
    // By DSP 402 v2 no factor alone makes a scale.
    let axis = AxisConfig::new("x")
        .unit::<Mm>(Scale::counts_per_unit(ratio(1000, 1)).velocity_counts_per_unit(ratio(7, 1)))
        .scale_mismatch(ScaleMismatch::Write);
    let line = Line::new(Segment::new().with(personality::ax2000()));
    let drive = DriveConfig::new(drives::ax2000()).axis(axis);
    let (_, difference, _) = disagrees(start(&line, drive).err().unwrap());
    assert_eq!(difference.object, ObjectAddress::new(0x6094, 1));
}

#[test]
fn a_drive_that_comes_back_with_another_scale_is_not_led_into_op() {
    // As its maker's tool has set it, not as a start-up line does at each start.
    let line = line();
    set(&line, 0x6092, 1, 5_000);
    let mut rig = start(&line, with(slide(ScaleMismatch::Refuse))).unwrap();
    rig.loses_power(&line, 0);
    let (_, difference, text) = disagrees(rig.recover(0).unwrap_err());
    assert_eq!(difference.got, TURN as f64, "{text}");
    assert_ne!(line.segment().devices()[0].al_state(), AlState::Op);
    let axis = rig.net().axis_in::<Mm>("x").unwrap();
    assert!(rig.until(axis.enable()).is_err());
    rig.shutdown();
}

#[test]
fn a_drive_whose_scale_was_changed_in_safeop_is_not_led_into_op_whatever_is_chosen() {
    for mismatch in [ScaleMismatch::Refuse, ScaleMismatch::Write] {
        let line = line();
        set(&line, 0x6092, 1, 5_000);
        let mut rig = start(&line, with(slide(mismatch))).unwrap();
        let fall = |line: &Line| {
            let mut segment = line.segment();
            segment.device_mut(0).unwrap().fall_to_safe_op(0x001B);
        };
        fall(&line);
        rig.run_for(100 * MS);
        set(&line, 0x6092, 1, 4_000);
        let (_, difference, text) = disagrees(rig.recover(0).unwrap_err());
        assert_eq!(
            (difference.expected, difference.got),
            (5_000.0, 4_000.0),
            "{text}"
        );
        assert_eq!(line.segment().devices()[0].al_state(), AlState::SafeOp);
        // Set right again, it is led back.
        set(&line, 0x6092, 1, 5_000);
        let recovered = rig.recover(0).unwrap();
        assert!(matches!(recovered, Recovered::FromSafeOp { .. }));
        rig.shutdown();
    }
}
