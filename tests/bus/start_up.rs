//! Start-up lists on the way to OP: in order, at their transitions, and refused by name.

use servocrab::{
    DriveConfig, Network, NetworkError,
    bus::{BringUpStep, DriveFault},
    coe::{AbortCode, ObjectAddress, obj},
    drives,
    parameters::{ObjectValue, StartUpError, StartUpList, StartUpWrite, Transition, WriteFault},
};
use servocrab_sim::{AlState, Segment, personality};

use crate::rig::{Line, Rig, akd2g};

fn start(line: &Line, drive: DriveConfig) -> Result<Rig, NetworkError> {
    Rig::start(Network::builder().link(line.wire()).drive(0, drive))
}

/// The line that failed, and the whole message.
fn refused(line: &Line, drive: DriveConfig) -> (StartUpError, String) {
    let Err(error) = start(line, drive) else {
        panic!("it came up");
    };
    let text = error.to_string();
    let NetworkError::Drive { step, error, .. } = error else {
        panic!("another error: {text}");
    };
    assert_eq!(step, BringUpStep::StartUpList, "{text}");
    let DriveFault::StartUp(error) = *error else {
        panic!("another fault: {text}");
    };
    (error, text)
}

fn value(line: &Line, index: u16) -> Option<i64> {
    line.segment().axis(0, 0).unwrap().get(index, 0)
}

#[test]
fn a_list_is_written_in_order_and_the_last_value_stays() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let list = StartUpList::from_toml(
        "[[write]]\nobject = \"position window\"\nvalue = 70\nverify = true\n\
         [[write]]\nobject = \"position window\"\nvalue = 71\nverify = true\n\
         [[write]]\nobject = \"position window\"\naxis = 2\nvalue = 72\n\
         [[write]]\nobject = \"6068h:00\"\nvalue = 9\ntransition = \"SAFEOP-OP\"\nverify = true\n",
        "line.toml",
    )
    .unwrap();
    let rig = start(&line, akd2g().start_up(list)).unwrap();
    assert_eq!(value(&line, 0x6067), Some(71));
    assert_eq!(value(&line, 0x6068), Some(9));
    assert_eq!(line.segment().axis(0, 1).unwrap().get(0x6067, 0), Some(72));
    rig.shutdown();
}

#[test]
fn a_refused_line_is_named_with_file_line_drive_object_comment_and_the_drives_abort() {
    let list = |number: usize| {
        let lines = (0..4).map(|line| {
            let object = if line == number { "2FFEh:07" } else { "6065h:00" };
            format!("[[write]]\nobject = \"{object}\"\ntype = \"u32\"\nvalue = {line}\ncomment = \"line {line}\"\n")
        });
        StartUpList::from_toml(&lines.collect::<String>(), "gantry.toml").unwrap()
    };
    for number in 0..4 {
        let line = Line::new(Segment::new().with(personality::akd2g()));
        let (error, text) = refused(&line, akd2g().start_up(list(number)));
        assert_eq!((error.number, error.of), (number + 1, 4));
        let place = format!(
            "gantry.toml:{}, 2FFEh:07 (\"line {number}\")",
            5 * number + 2
        );
        for part in ["drive 0 \"", place.as_str(), "06020000h"] {
            assert!(text.contains(part), "{part} is not in: {text}");
        }
        let WriteFault::Sdo(fault) = error.fault else {
            panic!("another fault: {text}");
        };
        assert_eq!(fault.abort_code(), Some(AbortCode::NO_OBJECT));
        // Those before it have been written, those behind it not.
        if let Some(last) = number.checked_sub(1) {
            assert_eq!(value(&line, 0x6065), Some(last as i64));
        }
    }
}

#[test]
fn a_line_of_safeop_is_written_in_safeop() {
    // The drive takes a PDO assignment in PREOP alone.
    let write = StartUpWrite::to(ObjectAddress::new(0x1C12, 0), 0_u8);
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let rig = start(&line, akd2g().start_up(write.clone())).unwrap();
    rig.shutdown();
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let late = write.at(Transition::SafeOpToOp);
    let (error, text) = refused(&line, akd2g().start_up(late));
    let WriteFault::Sdo(fault) = error.fault else {
        panic!("another fault: {text}");
    };
    assert_eq!(fault.abort_code(), Some(AbortCode::PRESENT_STATE), "{text}");
}

#[test]
fn what_the_drive_holds_in_place_of_what_was_written_is_shown() {
    // 1010h takes "save", and goes on reading 1.
    let write = StartUpWrite::to(ObjectAddress::new(0x1010, 1), u32::from_le_bytes(*b"save"));
    let drive = || DriveConfig::new(drives::sigma7()).axis("z");
    let line = Line::new(Segment::new().with(personality::sigma7()));
    start(&line, drive().start_up(write.clone()))
        .unwrap()
        .shutdown();
    let line = Line::new(Segment::new().with(personality::sigma7()));
    let (error, text) = refused(&line, drive().start_up(write.verified()));
    let WriteFault::Differs { expected, got } = error.fault else {
        panic!("another fault: {text}");
    };
    assert_eq!(expected, ObjectValue::U32(u32::from_le_bytes(*b"save")));
    assert_eq!(got, ObjectValue::U32(1));
    assert!(text.contains("line 1 of 1, 1010h:01"), "{text}");
    assert!(text.contains("the drive holds 1 (u32)"), "{text}");
}

#[test]
fn a_list_that_commands_an_axis_is_refused_before_anything_is_sent() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    for (object, reason) in [
        (0x6040, "the controlword is no parameter"),
        (0x6060, "the mode of operation is no parameter"),
        (0x6042, "a target is no parameter"),
        (0x6071, "a target is no parameter"),
        (0x607A, "a target is no parameter"),
        (0x60FF, "a target is no parameter"),
    ] {
        for offset in [0, 0x0800] {
            let object = ObjectAddress::new(object + offset, 0);
            let list = StartUpList::new()
                .write(StartUpWrite::new(obj::POSITION_WINDOW, 5))
                .write(StartUpWrite::to(object, 0x000F_u16));
            let Err(error) = start(&line, akd2g().start_up(list)) else {
                panic!("it came up with {object}");
            };
            let text = error.to_string();
            assert!(text.contains("line 2 of 2"), "{text}");
            assert!(text.contains(reason), "{text}");
        }
    }
    assert_eq!(line.segment().devices()[0].al_state(), AlState::Init);
}

#[test]
fn a_list_that_commands_an_axis_is_not_applied_either() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let mut rig = start(&line, akd2g()).unwrap();
    let sdo = rig.net().sdo(0).unwrap();
    let list = StartUpList::new()
        .write(StartUpWrite::new(obj::POSITION_WINDOW, 5))
        .write(StartUpWrite::new(obj::CONTROLWORD, 0x000F));
    let applied = rig.until(list.apply(&sdo, Transition::PreOpToSafeOp));
    assert_eq!(applied.unwrap_err().fault, WriteFault::Controlword);
    assert_ne!(value(&line, 0x6067), Some(5));
}

/// The outputs hold what was read in PREOP: a value that is written later would be gone in OP.
#[test]
fn a_line_of_safeop_for_an_object_of_the_outputs_is_refused_and_one_of_preop_is_in_force() {
    let slow = |at| {
        let write = StartUpWrite::new(obj::PROFILE_VELOCITY, 77);
        akd2g().start_up(write.at(at).verified())
    };
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let (error, text) = refused(&line, slow(Transition::SafeOpToOp));
    assert_eq!(error.fault, WriteFault::Output, "{text}");
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let rig = start(&line, slow(Transition::PreOpToSafeOp)).unwrap();
    assert_eq!(value(&line, 0x6081), Some(77));
    rig.shutdown();
}
