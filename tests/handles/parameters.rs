//! The five profile parameters go by process data or by SDO, each where it is mapped or is not; the drive sees the same.

use servocrab::{
    SetPoint,
    coe::{AnyObject, obj},
    profile_velocity::JogSetPoint,
};
use servocrab_sim::ds402::{Behaviour, Executed};

use crate::machine::{Machine, Variant};

/// 6081h to 6086h, and how many bytes each has.
const PARAMETERS: [(u16, usize); 5] = [
    (0x6081, 4),
    (0x6082, 4),
    (0x6083, 4),
    (0x6084, 4),
    (0x6086, 2),
];

fn variant(not_mapped: &[u16]) -> Variant {
    let both: [AnyObject; 2] = [obj::END_VELOCITY.into(), obj::MOTION_PROFILE_TYPE.into()];
    Variant {
        not_mapped: not_mapped.to_vec(),
        mapped_too: both
            .into_iter()
            .filter(|object| !not_mapped.contains(&object.index))
            .collect(),
        behaviour: Behaviour {
            profile_types: &[0, 1],
            ..Behaviour::akd2g()
        },
        ..Variant::default()
    }
}

fn latched(line: &Executed) -> [u32; 5] {
    [
        line.velocity,
        line.end_velocity,
        line.acceleration,
        line.deceleration,
        u32::from(line.profile_type.unsigned_abs()),
    ]
}

#[test]
fn the_drive_latches_the_same_parameters_whichever_way_each_of_them_goes() {
    for mask in 0..32 {
        let by_sdo: Vec<u16> = (0..5)
            .filter(|n| mask >> n & 1 == 1)
            .map(|n| PARAMETERS[n].0)
            .collect();
        let mut machine = Machine::of(1, &variant(&by_sdo));
        // What the drive holds where nothing else is said, as the axis' settings have it.
        for (index, value) in [(0x6081, 50_000), (0x6083, 500_000), (0x6084, 500_000)] {
            machine.drive().set(index, 0, value).unwrap();
        }
        let axis = machine.axis(0);
        machine.finish(axis.enable()).unwrap();
        let pp = machine.finish(axis.profile_position()).unwrap();
        let all = SetPoint::new()
            .velocity(20_000)
            .end_velocity(70)
            .acceleration(300_000)
            .deceleration(400_000)
            .profile_type(1);
        let some = SetPoint::new().acceleration(600_000);
        for (set_point, expected) in [
            (all, [20_000, 70, 300_000, 400_000, 1]),
            // What a move leaves out is what the drive held, not what the move before has brought.
            (some, [50_000, 0, 600_000, 500_000, 0]),
            (SetPoint::new(), [50_000, 0, 500_000, 500_000, 0]),
            (all, [20_000, 70, 300_000, 400_000, 1]),
        ] {
            drop(machine.finish(pp.move_rel(100_000, set_point)).unwrap());
            let line = machine.drive().ledger().last().cloned().unwrap();
            assert_eq!(latched(&line), expected, "by SDO: {by_sdo:X?}");
            machine.finish(axis.stop()).unwrap();
            machine.finish(axis.enable()).unwrap();
        }
        let written = machine.stations[0].sdo.written.lock().unwrap().clone();
        for (index, bytes) in PARAMETERS {
            let writes: Vec<_> = written.iter().filter(|(of, _)| *of == index).collect();
            assert_eq!(!writes.is_empty(), by_sdo.contains(&index), "{index:04X}h");
            assert!(writes.iter().all(|(_, value)| value.len() == bytes));
        }
    }
}

#[test]
fn what_a_move_has_brought_is_set_back_though_all_its_handles_are_gone() {
    let mut machine = Machine::of(1, &variant(&[0x6081, 0x6082]));
    machine.drive().set(0x6081, 0, 50_000).unwrap();
    let job = |machine: &mut Machine, set_point| {
        let axis = machine.axis(0);
        machine.finish(axis.enable()).unwrap();
        let pp = machine.finish(axis.profile_position()).unwrap();
        drop(machine.finish(pp.move_rel(100_000, set_point)).unwrap());
        machine.finish(axis.stop()).unwrap();
        let line = machine.drive().ledger().last().cloned().unwrap();
        (line.velocity, line.end_velocity)
    };
    let fast = SetPoint::new().velocity(20_000).end_velocity(70);
    assert_eq!(job(&mut machine, fast), (20_000, 70));
    assert_eq!(job(&mut machine, SetPoint::new()), (50_000, 0));
}

#[test]
fn the_ramps_of_a_jog_are_not_those_of_the_next_move() {
    let mut variant = variant(&[0x6083, 0x6084]);
    variant.mapped_too.push(obj::TARGET_VELOCITY.into());
    let mut machine = Machine::of(1, &variant);
    for (index, value) in [(0x6083, 500_000), (0x6084, 400_000)] {
        machine.drive().set(index, 0, value).unwrap();
    }
    let axis = machine.axis(0);
    machine.finish(axis.enable()).unwrap();
    let pv = machine.finish(axis.profile_velocity()).unwrap();
    let ramps = JogSetPoint::new(1_000)
        .acceleration(7_000)
        .deceleration(8_000);
    let jog = machine.finish(pv.jog(ramps)).unwrap();
    assert_eq!(machine.drive().get(0x6084, 0), Some(8_000));
    machine.finish(jog.release()).unwrap();
    machine.finish(pv.release()).unwrap();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let set_point = SetPoint::new().acceleration(600_000);
    let moved = machine.finish(pp.move_rel(1_000, set_point)).unwrap();
    machine.finish(moved.done()).unwrap();
    let line = machine.drive().ledger().last().cloned().unwrap();
    assert_eq!((line.acceleration, line.deceleration), (600_000, 400_000));
}
