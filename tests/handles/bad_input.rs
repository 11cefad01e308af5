//! What a program asks for by mistake: each mistake has its typed error, and the wire shows nothing of it.
//!
//! Each row runs on two equal machines in step. One is asked, the other is not; every output byte of every cycle is
//! compared, and so are the SDO writes and the drive's ledger.

use servocrab::{
    Axis, AxisError, BufferMode, Failure, ProfilePosition, Referencing, SetPoint,
    axis::{AxisErrorKind, Command, CommandId, Delivery, ParameterFault, Unsupported},
    coe::ObjectAddress,
    drives,
    ds402::Mode,
    profile_position::{Limits, LimitsRule, MinVelocity, PositionRange, RelativeBase, StartBits},
};

use servocrab_sim::ds402::{Behaviour, Plant};

use crate::machine::{Machine, Task, Variant};

/// What is asked for.
#[derive(Clone, Copy)]
enum Ask {
    Abs(i32, SetPoint),
    Rel(i32, SetPoint),
}

/// What the axis is like when it is asked.
#[derive(Clone, Copy)]
enum Before {
    Enabled,
    Disabled,
    Halted,
    Faulted,
    WrongMode,
    /// At position 1000, by an absolute move.
    At1000,
}

struct Row {
    mistake: &'static str,
    variant: Variant,
    before: Before,
    ask: Ask,
    expected: fn(&AxisError) -> bool,
}

/// On an axis that is exactly where its drive says: limits are figures to the count.
fn ideal() -> Variant {
    Variant {
        behaviour: Behaviour::akd2g().with_plant(Plant::ideal()),
        ..Variant::default()
    }
}

/// With 607Dh from −2000 to 2000 and 607Fh of 60000, less a home offset of 500.
fn limited() -> Variant {
    let mut variant = Variant {
        limits: Limits {
            software: Some(PositionRange {
                min: -2_000,
                max: 2_000,
            }),
            home_offset: 500,
            position_range: Some(PositionRange {
                min: -1_000_000,
                max: 1_000_000,
            }),
            max_velocity: Some(60_000),
            min_velocity: None,
        },
        ..ideal()
    };
    variant.traits.relative_base = RelativeBase::Demand;
    variant.traits.limits = LimitsRule::cia402();
    variant
}

/// With 2010h of 3000 in the unit of 6081h.
fn with_least() -> Variant {
    let mut variant = ideal();
    variant.limits.min_velocity = Some(3_000);
    variant.traits.limits.min_velocity = MinVelocity::AsProfileVelocity;
    variant
}

fn row(
    mistake: &'static str,
    variant: Variant,
    before: Before,
    ask: Ask,
    expected: fn(&AxisError) -> bool,
) -> Row {
    Row {
        mistake,
        variant,
        before,
        ask,
        expected,
    }
}

macro_rules! failed {
    ($failure:pat $(if $guard:expr)?) => {
        |error| matches!(&error.kind, AxisErrorKind::Failed($failure) $(if $guard)?)
    };
}

fn rows() -> Vec<Row> {
    use Before::{Disabled, Enabled, Faulted, Halted, WrongMode};
    let plain = ideal;
    // Written by SDO where 6081h is not mapped: that must not happen either.
    let fast = SetPoint::new().velocity(7_000);
    let unmapped = fast.profile_type(3);
    let ax2000 = || {
        let mut variant = plain();
        variant.traits = drives::ax2000().traits;
        variant
    };
    let no_blend = || {
        let mut variant = plain();
        variant.traits.blend = StartBits::Unsupported("it has no blending");
        variant
    };
    let unreferenced = || Variant {
        referencing: Referencing::ByHoming,
        ..plain()
    };
    vec![
        row(
            "a start that AX2000 lacks",
            ax2000(),
            Enabled,
            Ask::Abs(100, fast),
            failed!(Failure::Unsupported(Unsupported::Start {
                buffer_mode: BufferMode::Aborting,
                ..
            })),
        ),
        row(
            "a blend on a drive without",
            no_blend(),
            Enabled,
            Ask::Rel(100, fast.buffer_mode(BufferMode::Blending)),
            failed!(Failure::Unsupported(Unsupported::Start {
                buffer_mode: BufferMode::Blending,
                ..
            })),
        ),
        row(
            "a ramp that AX2000 lacks",
            ax2000(),
            Enabled,
            Ask::Abs(100, unmapped.buffer_mode(BufferMode::Buffered)),
            failed!(Failure::Unsupported(Unsupported::ProfileType {
                profile_type: 3,
                ..
            })),
        ),
        row(
            "a target above the corrected 607Dh",
            limited(),
            Enabled,
            Ask::Abs(1_501, fast),
            failed!(Failure::BeyondLimit {
                object: ObjectAddress {
                    index: 0x607D,
                    subindex: 2
                },
                limit: 1_500,
                asked: 1_501
            }),
        ),
        row(
            "a velocity above 607Fh",
            limited(),
            Enabled,
            Ask::Abs(100, fast.velocity(60_001)),
            failed!(Failure::BeyondLimit {
                limit: 60_000,
                asked: 60_001,
                ..
            }),
        ),
        row(
            "a velocity below 2010h",
            with_least(),
            Enabled,
            Ask::Rel(100, fast.velocity(2_999)),
            failed!(Failure::TooSlow {
                asked: 2_999,
                least: 3_000
            }),
        ),
        row(
            "a velocity of zero",
            plain(),
            Enabled,
            Ask::Abs(100, SetPoint::new().velocity(0)),
            failed!(Failure::Parameter {
                name: "profile velocity 6081h",
                fault: ParameterFault::Zero
            }),
        ),
        row(
            "while disabled",
            plain(),
            Disabled,
            Ask::Abs(100, fast),
            failed!(Failure::NotEnabled { .. }),
        ),
        row(
            "while halted",
            plain(),
            Halted,
            Ask::Abs(100, fast),
            failed!(Failure::Halted {
                delivery: Delivery::NotSent
            }),
        ),
        row(
            "in a fault",
            plain(),
            Faulted,
            Ask::Rel(100, fast),
            failed!(Failure::Fault { .. }),
        ),
        row(
            "in the wrong mode",
            plain(),
            WrongMode,
            Ask::Rel(100, fast),
            failed!(Failure::WrongMode {
                expected: Mode::ProfilePosition,
                shown: Mode::ProfileVelocity,
                delivery: Delivery::NotSent
            }),
        ),
        row(
            "unreferenced",
            unreferenced(),
            Enabled,
            Ask::Abs(100, fast),
            failed!(Failure::NotReferenced),
        ),
    ]
}

fn distances_beyond_limits() -> Vec<Row> {
    vec![
        row(
            "a distance to beyond 607Dh",
            limited(),
            Before::At1000,
            Ask::Rel(501, SetPoint::new()),
            failed!(Failure::BeyondLimit {
                object: ObjectAddress {
                    index: 0x607D,
                    subindex: 2
                },
                limit: 1_500,
                asked: 1_501
            }),
        ),
        row(
            "a distance beyond the number circle",
            limited(),
            Before::At1000,
            Ask::Rel(i32::MAX, SetPoint::new()),
            failed!(Failure::BeyondLimit {
                limit: 1_000_000,
                asked: 2_147_484_647,
                ..
            }),
        ),
    ]
}

/// The machine of a row, before it is asked.
fn prepare(row: &Row, variant: &Variant) -> (Machine, Axis, ProfilePosition) {
    let (mut machine, axis) = Machine::enabled_of(variant);
    let lease = machine.finish(axis.profile_position()).unwrap();
    match row.before {
        Before::Enabled => {}
        Before::Disabled => machine.finish(axis.disable()).unwrap(),
        Before::Halted => machine.finish(axis.halt()).unwrap(),
        Before::Faulted => machine.drive().inject_fault(0x2310),
        Before::WrongMode => {
            let (now, station) = (machine.now, &mut machine.stations[0]);
            let mode = Command::SelectMode(Mode::ProfileVelocity);
            station
                .core
                .submit(now, CommandId(u32::MAX), mode, &mut station.outputs);
            // It is written when the axis is known to stand.
            machine.run(200);
        }
        Before::At1000 => {
            let moved = machine
                .finish(lease.move_abs(1_000, SetPoint::new()))
                .unwrap();
            machine.finish(moved.done()).unwrap();
        }
    }
    machine.run(20);
    (machine, axis, lease)
}

async fn ask(lease: &ProfilePosition, ask: Ask) -> Result<(), AxisError> {
    match ask {
        Ask::Abs(target, set_point) => lease.move_abs(target, set_point).await.map(drop),
        Ask::Rel(distance, set_point) => lease.move_rel(distance, set_point).await.map(drop),
    }
}

fn step_both(asked: &mut Machine, untouched: &mut Machine, mistake: &str) {
    asked.cycle();
    untouched.cycle();
    assert_eq!(
        asked.stations[0].outputs, untouched.stations[0].outputs,
        "{mistake}: the outputs at {:?}",
        asked.now
    );
}

#[test]
fn each_mistake_has_its_error_and_leaves_the_wire_as_it_was() {
    leaves_the_wire_as_it_was(rows());
}

#[test]
fn a_distance_beyond_a_limit_has_its_error_and_leaves_the_wire_as_it_was() {
    leaves_the_wire_as_it_was(distances_beyond_limits());
}

fn leaves_the_wire_as_it_was(rows: Vec<Row>) {
    for row in rows {
        for not_mapped in [vec![], vec![0x6081, 0x6083, 0x6084]] {
            let mistake = format!("{} (not mapped: {not_mapped:X?})", row.mistake);
            let variant = Variant {
                not_mapped,
                ..row.variant.clone()
            };
            let (mut asked, _axis, lease) = prepare(&row, &variant);
            let (mut untouched, _other_axis, _other_lease) = prepare(&row, &variant);
            assert_eq!(asked.stations[0].outputs, untouched.stations[0].outputs);
            let written = asked.stations[0].sdo.written.lock().unwrap().len();
            let mut task = Task::new(ask(&lease, row.ask));
            let mut answer = task.poll();
            for _ in 0..20 {
                if answer.is_none() {
                    step_both(&mut asked, &mut untouched, &mistake);
                    answer = task.poll();
                }
            }
            let error = answer.expect(&mistake).expect_err(&mistake);
            assert!((row.expected)(&error), "{mistake}: {error:?}");
            for _ in 0..200 {
                step_both(&mut asked, &mut untouched, &mistake);
            }
            let ledger = asked.drive().ledger().len();
            assert_eq!(ledger, untouched.drive().ledger().len(), "{mistake}");
            let after = asked.stations[0].sdo.written.lock().unwrap().len();
            assert_eq!(after, written, "{mistake}: SDO writes");
        }
    }
}

#[test]
fn what_is_just_within_the_limits_is_moved() {
    let (mut machine, axis) = Machine::enabled_of(&limited());
    let pp = machine.finish(axis.profile_position()).unwrap();
    for target in [1_500, -2_500] {
        let moved = machine.finish(pp.move_abs(target, SetPoint::new().velocity(60_000)));
        machine.finish(moved.unwrap().done()).unwrap();
        assert_eq!(machine.drive().position(), i64::from(target));
    }
    let moved = machine.finish(pp.move_rel(4_000, SetPoint::new())).unwrap();
    machine.finish(moved.done()).unwrap();
    assert_eq!(machine.drive().position(), 1_500);
}

/// An object that does not begin at a byte would be read from two others.
#[test]
fn an_axis_is_refused_whose_objects_begin_at_no_byte() {
    use servocrab::{
        axis::{AxisFields, FieldError},
        coe::{AxisOffset, obj},
        pdo_map::{Direction, Mapping},
    };
    let fields = |bits: u8| {
        let mapping = Mapping::builder()
            .rx_pdo(0x1600)
            .output(obj::CONTROLWORD)
            .padding(Direction::Outputs, bits)
            .output(obj::TARGET_POSITION)
            .tx_pdo(0x1A00)
            .input(obj::STATUSWORD)
            .input(obj::POSITION_ACTUAL)
            .build()
            .unwrap();
        AxisFields::from_layout(&mapping.layout(), AxisOffset::default())
    };
    assert!(fields(8).is_ok());
    let object = ObjectAddress::new(0x607A, 0);
    assert_eq!(fields(3), Err(FieldError::Misplaced { object }));
}
