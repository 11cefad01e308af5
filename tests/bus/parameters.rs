//! Parameters of a drive on a running line: backed up, compared, restored, stored, and refused while an axis is enabled.

use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicU32, Ordering},
};

use servocrab::{
    AxisConfig, DriveConfig, Network, Referencing,
    coe::{AbortCode, ObjectAddress, obj},
    drives,
    ds402::State,
    link::Fate,
    parameters::{
        self, Backup, Held, MemoryFault, ObjectValue, Parameter, ParameterObject, ParameterSet,
        Progress, RestoreError, RestoreFault, Restored, WriteFault,
    },
};
use servocrab_sim::{Segment, personality};

use crate::rig::{Line, Rig, akd2g};

const WINDOW: ObjectAddress = ObjectAddress::new(0x6067, 0);
const WINDOW_2: ObjectAddress = ObjectAddress::new(0x6867, 0);
const NOWHERE: ObjectAddress = ObjectAddress::new(0x2FFE, 7);

fn line() -> (Line, Rig) {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let rig = Rig::start(Network::builder().link(line.wire()).drive(0, akd2g())).unwrap();
    (line, rig)
}

fn backup(rig: &mut Rig, axes: u8) -> Backup {
    let sdo = rig.net().sdo(0).unwrap();
    let objects = ParameterObject::known(axes);
    rig.until(ParameterSet::backup(&sdo, &objects, Progress::none()))
        .unwrap()
}

fn restore(rig: &mut Rig, set: &ParameterSet) -> Result<Restored, Box<RestoreError>> {
    let sdo = rig.net().sdo(0).unwrap();
    rig.until(set.restore(&sdo, Progress::none()))
        .map_err(Box::new)
}

fn parameter(object: ObjectAddress, value: impl Into<ObjectValue>) -> Parameter {
    Parameter {
        object,
        name: String::new(),
        value: value.into(),
    }
}

/// Five parameters of both axes that are not in the process data, with values of their own.
fn five() -> ParameterSet {
    let objects = [0x6065, 0x6067, 0x6085, 0x6865, 0x6867];
    let parameters = objects.into_iter().zip(101_u32..);
    ParameterSet {
        parameters: parameters
            .map(|(index, value)| parameter(ObjectAddress::new(index, 0), value))
            .collect(),
        ..ParameterSet::default()
    }
}

fn held(line: &Line, parameter: &Parameter) -> ObjectValue {
    let (axis, index) = match parameter.object.index {
        index @ ..0x6800 => (0, index),
        index => (1, index - 0x0800),
    };
    let value = line.segment().axis(0, axis).unwrap().get(index, 0).unwrap();
    ObjectValue::U32(u32::try_from(value).unwrap())
}

#[test]
fn a_backup_goes_through_its_file_and_brings_a_changed_drive_back() {
    let (line, mut rig) = line();
    let sdo = rig.net().sdo(0).unwrap();
    let before = backup(&mut rig, 2);
    assert!(before.refused.is_empty(), "{:?}", before.refused);
    assert!(
        before
            .missing
            .contains(&obj::MIN_PROFILE_VELOCITY.address())
    );
    let set = ParameterSet::from_toml(&before.set.to_toml(), "left.toml").unwrap();
    assert_eq!(set, before.set);
    let has = |object| {
        set.parameters
            .iter()
            .any(|parameter| parameter.object == object)
    };
    assert!(has(WINDOW) && has(WINDOW_2));
    assert!(!has(obj::CONTROLWORD.address()) && !has(obj::MODE_OF_OPERATION.address()));

    rig.until(sdo.write(obj::POSITION_WINDOW, 4711)).unwrap();
    rig.until(sdo.write(obj::QUICK_STOP_DECELERATION.axis(2), 4712))
        .unwrap();
    let differences = rig.until(set.compare(&sdo, Progress::none())).unwrap();
    let changed: Vec<_> = differences
        .0
        .iter()
        .map(|difference| (difference.parameter.object.index, difference.held.clone()))
        .collect();
    let value = |value: u32| Held::Value(value.into());
    assert_eq!(changed, [(0x6067, value(4711)), (0x6885, value(4712))]);
    assert!(
        differences.to_string().contains("4711 (u32)"),
        "{differences}"
    );

    let restored = restore(&mut rig, &set).unwrap();
    let expected = [WINDOW, ObjectAddress::new(0x6885, 0)];
    assert_eq!(restored.written, expected, "what differs and nothing else");
    assert_eq!(restored.unchanged.len(), set.parameters.len() - 2);
    let differences = rig.until(set.compare(&sdo, Progress::none())).unwrap();
    assert!(differences.0.is_empty(), "{differences}");
    drop(line);
    rig.shutdown();
}

#[test]
fn a_restore_that_is_refused_at_any_write_says_what_was_written_and_what_not() {
    for number in 0..5 {
        let (line, mut rig) = line();
        let mut set = five();
        set.parameters[number] = parameter(NOWHERE, 1_u32);
        let error = restore(&mut rig, &set).unwrap_err();
        let objects: Vec<_> = set.parameters.iter().map(|one| one.object).collect();
        assert_eq!(error.done.written, objects[..number]);
        assert_eq!(error.not_written, objects[number..]);
        assert_eq!(error.unconfirmed, None);
        let text = error.to_string();
        let not = 5 - number;
        for part in [
            format!("{number} written, {not} not"),
            "2FFEh:07".into(),
            "06020000h".into(),
        ] {
            assert!(text.contains(&part), "{part} is not in: {text}");
        }
        let RestoreFault::Write {
            fault: WriteFault::Sdo(fault),
            ..
        } = &error.fault
        else {
            panic!("another fault: {text}");
        };
        assert_eq!(fault.abort_code(), Some(AbortCode::NO_OBJECT));
        let (first, last) = set.parameters.split_at(number);
        assert!(first.iter().all(|one| held(&line, one) == one.value));
        assert!(last[1..].iter().all(|one| held(&line, one) != one.value));
        rig.shutdown();
    }
}

/// Whether a frame brings, behind its tag, a mail with an SDO download to a drive (FPWR; mailbox type 3; CoE service 2).
fn is_download(frame: &[u8]) -> bool {
    frame[32] == 5
        && frame.len() > 50
        && frame[47] & 0x0F == 3
        && frame[49] == 0x20
        && frame[50] & 0xE0 == 0x20
}

#[test]
fn a_drive_that_loses_its_power_at_a_write_leaves_that_one_in_doubt_and_the_rest_unwritten() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    // Counts down while the restore writes; the power goes with the write at which it ends.
    let left = Arc::new(AtomicU32::new(0));
    let (counted, segment) = (Arc::clone(&left), line.clone());
    let wire = line.wire_with(move |_, frame| {
        if is_download(frame) {
            let before = counted.load(Ordering::Relaxed);
            counted.store(before.saturating_sub(1), Ordering::Relaxed);
            if before == 1 {
                segment.segment().device_mut(0).unwrap().power_off();
            }
        }
        Fate::Deliver
    });
    let mut rig = Rig::start(Network::builder().link(wire).drive(0, akd2g())).unwrap();
    left.store(3, Ordering::Relaxed);
    let error = restore(&mut rig, &five()).unwrap_err();
    let objects: Vec<_> = five().parameters.iter().map(|one| one.object).collect();
    assert_eq!(error.done.written, objects[..2], "{error}");
    assert_eq!(error.unconfirmed, Some(objects[2]), "{error}");
    assert_eq!(error.not_written, objects[3..], "{error}");
    assert!(
        error.to_string().contains("6085h:00 not confirmed"),
        "{error}"
    );
}

/// The same of an SDO upload of this object.
fn is_upload(frame: &[u8], object: u16) -> bool {
    frame[32] == 5
        && frame.len() > 53
        && frame[47] & 0x0F == 3
        && frame[49] == 0x20
        && frame[50] & 0xE0 == 0x40
        && frame[51..53] == object.to_le_bytes()
}

/// An SDO command specifier that no drive knows.
const UNKNOWN_COMMAND: u8 = 0xE0;

/// A line whose drive refuses to read this object, for it does not know the command.
fn refusing_to_read(object: u16) -> (Line, Rig, Arc<AtomicBool>) {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let refuses = Arc::new(AtomicBool::new(false));
    let on = Arc::clone(&refuses);
    let wire = line.spoiled_wire(move |frame| {
        if on.load(Ordering::Relaxed) && is_upload(frame, object) {
            frame[50] = UNKNOWN_COMMAND;
        }
    });
    let rig = Rig::start(Network::builder().link(wire).drive(0, akd2g())).unwrap();
    (line, rig, refuses)
}

#[test]
fn an_axis_whose_statusword_is_refused_is_not_taken_for_one_that_is_not_there() {
    let (line, mut rig, refuses) = refusing_to_read(0x6841);
    let y = rig.net().axis("y").unwrap();
    rig.until(y.enable()).unwrap();
    refuses.store(true, Ordering::Relaxed);
    let error = restore(&mut rig, &five()).unwrap_err();
    let RestoreFault::Sdo(fault) = &error.fault else {
        panic!("another fault: {error}");
    };
    assert_eq!(fault.abort_code(), Some(AbortCode::COMMAND));
    assert_eq!(error.done, Restored::default());
    let set = five();
    let mut all = set.parameters.iter();
    assert!(all.all(|one| held(&line, one) != one.value));
    rig.shutdown();
}

#[test]
fn a_value_that_the_drive_does_not_hold_is_shown_with_the_one_that_it_holds() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    // The drive takes 6085h, but as one more or less than was written.
    let wire = line.spoiled_wire(|frame| {
        if is_download(frame) && frame[51..53] == 0x6085_u16.to_le_bytes() {
            frame[54] ^= 1;
        }
    });
    let mut rig = Rig::start(Network::builder().link(wire).drive(0, akd2g())).unwrap();
    let error = restore(&mut rig, &five()).unwrap_err();
    let RestoreFault::Write {
        fault: WriteFault::Differs { expected, got },
        ..
    } = &error.fault
    else {
        panic!("another fault: {error}");
    };
    assert_eq!((expected, got), (&103_u32.into(), &102_u32.into()));
    assert_eq!((error.done.written.len(), error.not_written.len()), (2, 3));
    assert_eq!(error.unconfirmed, None);
    let text = error.to_string();
    assert!(
        text.contains("wrote 103 (u32), but the drive holds 102 (u32)"),
        "{text}"
    );
    rig.shutdown();
}

#[test]
fn nothing_is_restored_stored_or_set_back_while_an_axis_is_enabled() {
    let (line, mut rig) = line();
    let sdo = rig.net().sdo(0).unwrap();
    // The second axis is enabled, and all parameters are those of the first.
    let y = rig.net().axis("y").unwrap();
    rig.until(y.enable()).unwrap();
    let mut set = five();
    set.parameters.truncate(3);
    let error = restore(&mut rig, &set).unwrap_err();
    let RestoreFault::Enabled(enabled) = error.fault else {
        panic!("another fault: {error}");
    };
    assert_eq!((enabled.axis, enabled.state), (2, State::OperationEnabled));
    assert_eq!(
        (error.done, error.not_written.len()),
        (Restored::default(), 3)
    );
    assert!(
        set.parameters
            .iter()
            .all(|one| held(&line, one) != one.value)
    );
    rig.until(y.disable()).unwrap();
    assert_eq!(restore(&mut rig, &set).unwrap().written.len(), 3);
    drop(sdo);
    rig.shutdown();
}

#[test]
fn an_axis_that_is_enabled_while_parameters_are_restored_ends_the_restore() {
    let (line, mut rig) = line();
    let sdo = rig.net().sdo(0).unwrap();
    let x = rig.net().axis("x").unwrap();
    // Both at once: the axis is enabled within some of the many writes.
    let mut set = ParameterSet::default();
    for round in 0..200_u32 {
        set.parameters.push(parameter(WINDOW, 1000 + round));
    }
    let (restored, enabled) = rig.until(smol::future::zip(
        set.restore(&sdo, Progress::none()),
        x.enable(),
    ));
    enabled.unwrap();
    let error = restored.unwrap_err();
    assert!(
        matches!(error.fault, RestoreFault::Enabled(enabled) if enabled.axis == 1),
        "{error}"
    );
    let written = error.done.written.len();
    assert!(
        written < 200 && written + error.not_written.len() == 200,
        "{error}"
    );
    let last = 999 + i64::try_from(written).unwrap();
    let window = line.segment().axis(0, 0).unwrap().get(0x6067, 0);
    assert!(
        written == 0 || window == Some(last),
        "{window:?}, {written} written"
    );
    rig.shutdown();
}

#[test]
fn parameters_of_another_drive_and_commands_are_refused_before_anything_is_written() {
    let (line, mut rig) = line();
    let mut set = five();
    let mut identity = rig.net().sdo(0).unwrap().drive().identity;
    identity.product += 1;
    set.identity = Some(identity);
    let error = restore(&mut rig, &set).unwrap_err();
    assert!(
        matches!(error.fault, RestoreFault::OtherDrive { .. }),
        "{error}"
    );
    set.identity = None;
    set.parameters
        .push(parameter(obj::CONTROLWORD.axis(2).address(), 15_u16));
    let error = restore(&mut rig, &set).unwrap_err();
    assert!(
        matches!(error.fault, RestoreFault::NoParameter(_)),
        "{error}"
    );
    assert!(
        five()
            .parameters
            .iter()
            .all(|one| held(&line, one) != one.value)
    );
    rig.shutdown();
}

#[test]
fn a_drive_stores_its_parameters_and_goes_back_to_its_defaults() {
    let line = Line::new(Segment::new().with(personality::sigma7()));
    let drive = DriveConfig::new(drives::sigma7())
        .axis(AxisConfig::new("z").referencing(Referencing::UnreferencedMovesAllowed));
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap();
    let sdo = rig.net().sdo(0).unwrap();
    let z = rig.net().axis("z").unwrap();
    let limit = || line.segment().axis(0, 0).unwrap().get(0x607D, 1);

    rig.until(z.enable()).unwrap();
    for fault in [
        rig.until(parameters::store(&sdo)).unwrap_err().fault,
        rig.until(parameters::load_defaults(&sdo))
            .unwrap_err()
            .fault,
    ] {
        assert!(matches!(fault, MemoryFault::Enabled(_)), "{fault}");
    }
    rig.until(z.disable()).unwrap();

    for support in [
        rig.until(parameters::store_support(&sdo)),
        rig.until(parameters::defaults_support(&sdo)),
    ] {
        let support = support.unwrap().unwrap();
        assert!(support.on_command && !support.by_itself);
    }
    rig.until(sdo.write(obj::SOFTWARE_LIMIT_MIN, -4711))
        .unwrap();
    rig.until(parameters::store(&sdo)).unwrap();
    let cycle = |rig: &Rig| {
        let mut segment = line.segment();
        let device = segment.device_mut(0).unwrap();
        device.power_off();
        device.power_on(rig.bus.now());
    };
    // Told to forget, the drive goes on with what it has until its power is off and on.
    rig.until(parameters::load_defaults(&sdo)).unwrap();
    assert_eq!(limit(), Some(-4711));
    rig.until(parameters::store(&sdo)).unwrap();
    cycle(&rig);
    assert_eq!(limit(), Some(-4711), "stored");
}

#[test]
fn defaults_are_in_force_after_the_next_power_up() {
    let line = Line::new(Segment::new().with(personality::sigma7()));
    let drive = DriveConfig::new(drives::sigma7()).axis("z");
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap();
    let sdo = rig.net().sdo(0).unwrap();
    let limit = || line.segment().axis(0, 0).unwrap().get(0x607D, 1);
    let default = limit();
    rig.until(sdo.write(obj::SOFTWARE_LIMIT_MIN, -4711))
        .unwrap();
    rig.until(parameters::store(&sdo)).unwrap();
    rig.until(parameters::load_defaults(&sdo)).unwrap();
    {
        let mut segment = line.segment();
        let device = segment.device_mut(0).unwrap();
        device.power_off();
        device.power_on(rig.bus.now());
    }
    assert_eq!(limit(), default);
    assert_ne!(default, Some(-4711));
}

#[test]
fn a_drive_without_1010h_says_so() {
    let (_, mut rig) = line();
    let sdo = rig.net().sdo(0).unwrap();
    assert_eq!(rig.until(parameters::store_support(&sdo)).unwrap(), None);
    let error = rig.until(parameters::store(&sdo)).unwrap_err();
    assert!(matches!(error.fault, MemoryFault::NotThere { object } if object.index == 0x1010));
    assert!(error.to_string().contains("1010h:01"), "{error}");
    let error = rig.until(parameters::load_defaults(&sdo)).unwrap_err();
    assert!(matches!(error.fault, MemoryFault::NotThere { object } if object.index == 0x1011));
    rig.shutdown();
}

#[test]
fn a_drive_says_itself_which_parameters_it_has_or_the_library_knows_them() {
    let described = personality::generic();
    let silent = personality::Servo::akd2g()
        .without_sdo_information()
        .build();
    for (device, axes, own) in [(described, 1, true), (silent, 2, false)] {
        let description = if axes == 1 {
            drives::generic()
        } else {
            drives::akd2g()
        };
        let line = Line::new(Segment::new().with(device));
        let config = DriveConfig::new(description).axis("x");
        let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, config)).unwrap();
        let sdo = rig.net().sdo(0).unwrap();
        let objects = rig.until(ParameterObject::of(&sdo)).unwrap();
        let backup = rig
            .until(ParameterSet::backup(&sdo, &objects, Progress::none()))
            .unwrap();
        let has = |object| {
            let mut all = backup.set.parameters.iter();
            all.any(|parameter| parameter.object == object)
        };
        // Its own text at 5F00h is in its dictionary alone.
        assert_eq!(has(ObjectAddress::new(0x5F00, 0)), own);
        assert_eq!(has(WINDOW_2), axes == 2);
        assert!(has(WINDOW) && !has(obj::CONTROLWORD.address()));
        assert!(!has(ObjectAddress::new(0x1600, 0)) && !has(ObjectAddress::new(0x1C12, 0)));
        // What a drive lists it has; of what the library knows it has a part.
        assert_eq!(backup.missing.is_empty(), own, "{:?}", backup.missing);
        assert!(backup.refused.is_empty(), "{:?}", backup.refused);
        rig.shutdown();
    }
}

/// A backup of a drive that no network has started yet holds what its maker has put there.
#[test]
fn a_restore_leaves_as_it_is_what_an_axis_does_when_its_program_dies() {
    let (line, mut rig) = line();
    let objects = [0x6007, 0x6807].map(|index| ObjectAddress::new(index, 0));
    let mut set = five();
    for object in objects {
        set.parameters.push(parameter(object, 0_i16));
    }
    let restored = restore(&mut rig, &set).unwrap();
    assert_eq!(restored.written.len(), 5);
    assert_eq!(restored.unchanged, objects);
    for axis in 0..2 {
        let segment = line.segment();
        let held = segment.axis(0, axis).unwrap().get(0x6007, 0);
        assert_eq!(held, Some(3), "a quick stop");
    }
    rig.shutdown();
}
