//! What a drive says of its faults: bit 13 and the maker's texts in errors, and the histories 1003h and 10F3h.

use std::time::Duration;

use servocrab::{
    DriveConfig, Failure, Network, SetPoint,
    coe::{DiagnosisParameter, DriveHistory, ErrorTexts, HistoryRecord, Severity},
    drives,
};
use servocrab_sim::{Segment, personality::Servo};

use super::rig::{Line, Rig, akd2g, unhomed};

const MS: Duration = Duration::from_millis(1);

fn start(servo: Servo, drive: DriveConfig) -> (Line, Rig) {
    let line = Line::ideal(Segment::new().with(servo.build()));
    let rig = Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap();
    (line, rig)
}

/// One fault after the other, each reset before the next.
fn fault_with(line: &Line, rig: &mut Rig, codes: &[u16]) {
    let axis = rig.net().axis("x").unwrap();
    for code in codes {
        line.segment().axis_mut(0, 0).unwrap().inject_fault(*code);
        rig.run_for(20 * MS);
        rig.until(axis.reset_fault()).unwrap();
    }
}

fn history(rig: &Rig) -> DriveHistory {
    rig.net().history(0).unwrap()
}

fn read(rig: &mut Rig) -> HistoryRecord {
    let history = history(rig);
    rig.until(history.read()).unwrap()
}

/// The codes of 1003h, and those of 10F3h with their subindices.
fn codes(record: &HistoryRecord) -> (Vec<u16>, Vec<(u8, u16)>) {
    let errors = record.errors.iter().flatten();
    let messages = record.diagnosis.iter().flat_map(|all| &all.messages);
    (
        errors.map(|error| error.code).collect(),
        messages
            .map(|message| (message.subindex, message.error_code().unwrap()))
            .collect(),
    )
}

#[test]
fn a_following_error_is_named_in_the_fault_and_in_the_status_with_the_code_and_the_makers_text() {
    let (line, mut rig) = start(Servo::akd2g(), akd2g());
    let axis = rig.net().axis("x").unwrap();
    rig.until(axis.enable()).unwrap();
    let mode = rig.until(axis.profile_position()).unwrap();
    let motion = rig
        .until(mode.move_rel(1_000_000, SetPoint::new().velocity(50_000)))
        .unwrap();
    rig.run_for(100 * MS);
    assert!(!axis.status().shows_following_error());
    {
        let mut segment = line.segment();
        let shaft = segment.axis_mut(0, 0).unwrap();
        shaft.set(0x6065, 0, 1_000).unwrap();
        shaft.disturbances().blocked = true;
    }
    let error = rig.until(motion.done()).unwrap_err();
    let failure = Failure::Fault {
        code: Some(0x8611),
        following_error: true,
    };
    assert_eq!(error.failure(), Some(failure));
    let text = "the drive has a fault with following error (statusword bit 13): 8611h (following error); the maker says: F6001 following error magnitude";
    assert_eq!(error.reason().to_string(), text);
    assert!(error.to_string().ends_with(text), "{error}");
    rig.run_for(500 * MS);
    let status = axis.status();
    assert!(status.shows_following_error());
    let shown = status.to_string();
    assert!(
        shown.starts_with("Fault, following error (statusword 2"),
        "{shown}"
    );
}

#[test]
fn a_fault_of_the_makers_own_code_has_the_text_of_the_users_file() {
    let file = "0xFF01 = \"brake resistor missing\"\n7305h = \"A.C90 encoder cable\"";
    let texts = ErrorTexts::from_toml(file, "alarms.toml").unwrap();
    let (line, mut rig) = start(Servo::akd2g(), akd2g().error_texts(texts));
    let axis = rig.net().axis("x").unwrap();
    for (code, text) in [
        (
            0xFF01,
            "FF01h (manufacturer specific); the maker says: brake resistor missing",
        ),
        (
            0x7305,
            "7305h (incremental encoder 1 fault); the maker says: A.C90 encoder cable",
        ),
        (0x3220, "3220h (DC link under-voltage)"),
    ] {
        rig.until(axis.enable()).unwrap();
        let mode = rig.until(axis.profile_position()).unwrap();
        let motion = rig
            .until(mode.move_rel(1_000_000, SetPoint::new()))
            .unwrap();
        line.segment().axis_mut(0, 0).unwrap().inject_fault(code);
        let error = rig.until(motion.done()).unwrap_err();
        let reason = error.reason().to_string();
        assert_eq!(reason, format!("the drive has a fault: {text}"));
        drop(mode);
        rig.run_for(500 * MS);
        rig.until(axis.reset_fault()).unwrap();
    }
    // The description's own texts are still there.
    let record = read(&mut rig);
    let errors: Vec<_> = record
        .errors
        .unwrap()
        .iter()
        .map(ToString::to_string)
        .collect();
    assert_eq!(
        errors,
        [
            "3220h (DC link under-voltage)",
            "7305h (incremental encoder 1 fault; A.C90 encoder cable)",
            "FF01h (brake resistor missing)",
        ]
    );
}

#[test]
fn three_faults_are_read_newest_first_and_stay_until_the_program_clears_them() {
    let (line, mut rig) = start(Servo::akd2g().diagnosis_history(3), akd2g());
    let before = read(&mut rig);
    assert_eq!(codes(&before), (vec![], vec![]));
    assert!(!before.diagnosis.unwrap().has_new);
    fault_with(&line, &mut rig, &[0x7305, 0x3220, 0x2310]);
    let first = read(&mut rig);
    let newest_first = vec![0x2310, 0x3220, 0x7305];
    let in_places = vec![(8, 0x2310), (7, 0x3220), (6, 0x7305)];
    assert_eq!(codes(&first), (newest_first, in_places));
    let all = first.diagnosis.as_ref().unwrap();
    assert!(all.has_new && !all.has_lost && !all.keeps_unacknowledged);
    assert_eq!((all.room, all.acknowledged), (3, None));
    let [newest, .., oldest] = &*all.messages else {
        panic!("{all:?}")
    };
    assert_eq!(newest.severity, Severity::Error);
    assert!(newest.is_local_time && newest.time_ns > oldest.time_ns);
    let register = DiagnosisParameter::Number {
        data_type: 5,
        bytes: vec![0b0000_0011],
    };
    assert_eq!(newest.parameters, [register]);
    assert_eq!(
        newest.to_string(),
        "error 2310E800h (continuous over-current at the output), 0x03"
    );
    // Reading and resetting clear nothing.
    let again = read(&mut rig);
    assert_eq!(codes(&again), codes(&first));
    assert!(!again.diagnosis.unwrap().has_new);
    let history = history(&rig);
    rig.until(history.clear()).unwrap();
    assert_eq!(codes(&read(&mut rig)), (vec![], vec![]));
}

#[test]
fn the_fourth_fault_takes_the_place_of_the_oldest_message_and_that_is_said() {
    let (line, mut rig) = start(Servo::akd2g().diagnosis_history(3), akd2g());
    fault_with(&line, &mut rig, &[0x7305, 0x3220, 0x2310, 0x4210]);
    let record = read(&mut rig);
    assert_eq!(
        codes(&record),
        (
            vec![0x4210, 0x2310, 0x3220, 0x7305],
            vec![(6, 0x4210), (8, 0x2310), (7, 0x3220)]
        )
    );
    assert!(record.diagnosis.unwrap().has_lost);
}

#[test]
fn where_messages_wait_for_an_acknowledgement_a_program_gives_it_and_clears_them() {
    let (line, mut rig) = start(Servo::akd2g().diagnosis_history(3), akd2g());
    let sdo = rig.net().sdo(0).unwrap();
    rig.until(sdo.write_bytes(0x10F3, 5, vec![0x10, 0]))
        .unwrap();
    fault_with(&line, &mut rig, &[0x7305, 0x3220, 0x2310, 0x4210]);
    let record = read(&mut rig).diagnosis.unwrap();
    assert!(record.has_lost && record.keeps_unacknowledged && record.has_new);
    let history = history(&rig);
    // The second one, and with it the first.
    rig.until(history.acknowledge(&record.messages[1])).unwrap();
    fault_with(&line, &mut rig, &[0x5530]);
    let record = read(&mut rig);
    assert_eq!(record.diagnosis.as_ref().unwrap().acknowledged, Some(7));
    let (_, messages) = codes(&record);
    assert_eq!(messages, [(6, 0x5530), (8, 0x2310), (7, 0x3220)]);
    rig.until(history.clear()).unwrap();
    assert_eq!(codes(&read(&mut rig)), (vec![], vec![]));
}

#[test]
fn a_drive_without_a_diagnosis_history_has_its_errors_alone() {
    let drive = unhomed(drives::sigma7(), &["x"]);
    let (line, mut rig) = start(Servo::sigma7(), drive);
    fault_with(&line, &mut rig, &[0x8311]);
    let record = read(&mut rig);
    assert_eq!(record.diagnosis, None);
    assert_eq!(codes(&record).0, [0x8311]);
    let history = history(&rig);
    rig.until(history.clear()).unwrap();
    assert_eq!(codes(&read(&mut rig)), (vec![], vec![]));
}
