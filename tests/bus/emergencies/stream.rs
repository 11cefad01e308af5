//! The emergencies as a program gets them: of one drive, of all drives, and what is told when nobody took them in time.

use servocrab::{
    AxisConfig, DriveConfig, Failure, Network, Referencing, SetPoint,
    axis::AxisErrorKind,
    bus::NetworkEvent,
    coe::{Emergencies, Emergency, EmergencyReport},
    drives,
};
use servocrab_sim::{
    Segment,
    personality::{self, Servo},
};
use smol::stream::StreamExt;

use super::line::{Line, MS, Rig, emergency};

/// What is kept of one drive, and of all, as `Network` says.
const KEPT: u64 = 64;
const KEPT_OF_ALL: u64 = 256;

/// Two-axis drives in OP; only their first axis is used.
fn drives_in_op(count: u16) -> (Line, Rig) {
    let segment = (0..count).fold(Segment::new(), |line, _| line.with(personality::akd2g()));
    let line = Line::new(segment);
    let rig = start(&line, count);
    (line, rig)
}

fn start(line: &Line, count: u16) -> Rig {
    let builder = Network::builder().link(line.wire());
    Rig::start((0..count).fold(builder, |builder, position| {
        let name = position.to_string();
        let config = DriveConfig::new(drives::akd2g())
            .axis(AxisConfig::new(&name).referencing(Referencing::UnreferencedMovesAllowed));
        builder.drive(position, config)
    }))
}

/// What waits: each emergency with its drive's position, and what was lost where.
fn waiting(emergencies: &Emergencies) -> Vec<Result<(u16, Emergency), u64>> {
    std::iter::from_fn(|| emergencies.try_next())
        .map(|report| match report {
            EmergencyReport::Emergency(got) => Ok((got.drive.position, got.emergency)),
            EmergencyReport::Overflow { lost } => Err(lost),
            other => panic!("neither of them: {other}"),
        })
        .collect()
}

fn numbers(position: u16, numbers: std::ops::Range<u64>) -> Vec<Result<(u16, Emergency), u64>> {
    numbers
        .map(|number| Ok((position, emergency(number))))
        .collect()
}

fn inject(line: &Line, rig: &Rig, position: u16, numbers: std::ops::Range<u64>) {
    let many: Vec<_> = numbers.map(emergency).collect();
    line.inject(position.into(), &many, rig.bus.now());
}

#[test]
fn a_burst_up_to_the_bound_is_kept_whole() {
    let (line, mut rig) = drives_in_op(1);
    for burst in [1, 2, 16, 17, KEPT] {
        inject(&line, &rig, 0, 0..burst);
        rig.run_for(100 * MS);
        assert_eq!(
            waiting(&rig.emergencies(0)),
            numbers(0, 0..burst),
            "{burst}"
        );
        assert_eq!(
            waiting(&rig.net.all_emergencies()),
            numbers(0, 0..burst),
            "{burst}"
        );
    }
}

#[test]
fn beyond_the_bound_the_first_are_kept_and_the_number_of_the_others_is_told_in_their_place() {
    let (line, mut rig) = drives_in_op(1);
    inject(&line, &rig, 0, 0..KEPT + 16);
    rig.run_for(200 * MS);
    let emergencies = rig.emergencies(0);
    // Two places are free again: the next is behind what was lost.
    let first: Vec<_> = (0..2).map(|_| emergencies.try_next().unwrap()).collect();
    assert!(
        first
            .iter()
            .all(|report| matches!(report, EmergencyReport::Emergency(_)))
    );
    inject(&line, &rig, 0, 500..501);
    rig.run_for(20 * MS);
    let mut expected = numbers(0, 2..KEPT);
    expected.push(Err(16));
    expected.extend(numbers(0, 500..501));
    assert_eq!(waiting(&emergencies), expected);
}

#[test]
fn all_emergencies_are_those_of_each_drive_in_a_queue_of_their_own() {
    let (line, mut rig) = drives_in_op(4);
    for round in 0..5 {
        for position in [2, 0, 3, 1] {
            inject(&line, &rig, position, round..round + 1);
            rig.run_for(10 * MS);
        }
    }
    let expected: Vec<_> = (0..5)
        .flat_map(|round| [2, 0, 3, 1].map(|position| Ok((position, emergency(round)))))
        .collect();
    assert_eq!(waiting(&rig.net.all_emergencies()), expected);
    for position in 0..4 {
        assert_eq!(waiting(&rig.emergencies(position)), numbers(position, 0..5));
    }
}

#[test]
fn what_no_queue_took_is_told_by_each_with_its_own_number() {
    let (line, mut rig) = drives_in_op(3);
    for position in 0..3 {
        inject(&line, &rig, position, 0..100);
    }
    rig.run_for(500 * MS);
    for position in 0..3 {
        let mut expected = numbers(position, 0..KEPT);
        expected.push(Err(100 - KEPT));
        assert_eq!(waiting(&rig.emergencies(position)), expected);
    }
    let of_all = waiting(&rig.net.all_emergencies());
    let kept: Vec<_> = of_all.iter().filter(|report| report.is_ok()).collect();
    assert_eq!(kept.len() as u64, KEPT_OF_ALL);
    assert_eq!(of_all.last(), Some(&Err(300 - KEPT_OF_ALL)));
}

#[test]
fn nobody_needs_to_read_them() {
    let (line, mut rig) = drives_in_op(1);
    inject(&line, &rig, 0, 0..1_000);
    let axis = rig.net.axis("0").unwrap();
    let sdo = rig.net.sdo(0).unwrap();
    rig.until(async {
        axis.enable().await.unwrap();
        let mode = axis.profile_position().await.unwrap();
        let motion = mode.move_rel(1_000, SetPoint::new()).await.unwrap();
        assert_eq!(sdo.read_bytes(0x1018, 1).await.unwrap(), [0x6A, 0, 0, 0]);
        motion.done().await.unwrap();
    });
    let statistics = rig.net.statistics();
    assert_eq!((statistics.lost, statistics.late_cycles), (0, 0));
}

#[test]
fn emergencies_after_every_few_datagrams_come_in_order_beside_segmented_transfers() {
    const NOTE: u16 = 0x5F00;
    let line = Line::new(Segment::new().with(Servo::akd2g().mailbox_bytes(64).build()));
    let mut rig = start(&line, 1);
    let sdo = rig.net.sdo(0).unwrap();
    let emergencies = rig.emergencies(0);
    for every in 4..=16 {
        line.every(every, 0);
        for round in 0..20 {
            let text: Vec<u8> = (0..100).map(|n| n ^ round).collect();
            rig.until(async {
                sdo.write_bytes(NOTE, 0, text.clone()).await.unwrap();
                assert_eq!(sdo.read_bytes(NOTE, 0).await.unwrap(), text);
            });
        }
        let sent = line.every(0, 0);
        rig.run_for(100 * MS);
        assert!(sent > 10, "{sent}");
        let mut got = waiting(&emergencies);
        let lost = got.iter().position(Result::is_err);
        assert_eq!(
            lost.map(|place| got.split_off(place)),
            (sent > KEPT).then(|| vec![Err(sent - KEPT)])
        );
        assert_eq!(
            got,
            numbers(0, 0..sent.min(KEPT)),
            "every {every} datagrams"
        );
    }
}

#[test]
fn a_fault_and_its_reset_are_told_as_1003h_and_1001h_tell_them() {
    let (line, mut rig) = drives_in_op(1);
    let axis = rig.net.axis("0").unwrap();
    let sdo = rig.net.sdo(0).unwrap();
    let emergencies = rig.emergencies(0);
    let codes = [0x7320, 0x3220, 0x8611];
    for code in codes {
        rig.until(axis.enable()).unwrap();
        line.with_segment(|segment| segment.axis_mut(0, 0).unwrap().inject_fault(code));
        let fault = rig.until(emergencies.next()).unwrap().emergency().unwrap();
        assert_eq!(fault.emergency.code, code);
        let register = rig.until(sdo.read_bytes(0x1001, 0)).unwrap();
        assert_eq!(register, [fault.emergency.register]);
        rig.until(axis.reset_fault()).unwrap();
        let reset = rig.until(emergencies.next()).unwrap().emergency().unwrap();
        assert!(reset.emergency.is_reset(), "{reset}");
        assert_eq!(reset.text, "no error, or error reset");
    }
    let kept = rig.until(sdo.read_bytes(0x1003, 0)).unwrap();
    assert_eq!(kept, [3], "a reset is no error");
    for (subindex, code) in (1..).zip(codes.iter().rev()) {
        let error = rig.until(sdo.read_bytes(0x1003, subindex)).unwrap();
        assert_eq!(error[..2], u16::to_le_bytes(*code));
    }
}

#[test]
fn the_text_is_the_drives_own_where_its_description_has_one() {
    let segment = Segment::new()
        .with(personality::sigma7())
        .with(personality::akd2g());
    let line = Line::new(segment);
    let mut akd2g = drives::akd2g();
    akd2g
        .error_texts
        .codes
        .insert(0x7320, "a text of this drive".into());
    let builder = Network::builder()
        .link(line.wire())
        .drive(0, DriveConfig::new(drives::sigma7()).axis("s"))
        .drive(1, DriveConfig::new(akd2g).axis("a"));
    let mut rig = Rig::start(builder);
    let now = rig.bus.now();
    let alarm = Emergency {
        code: 0xFF00,
        register: 0x81,
        data: [0, 0x10, 0x07, 0, 0],
    };
    line.inject(0, &[alarm], now);
    let of_all = rig.net.all_emergencies();
    let mut texts = Vec::new();
    let got = rig.until(of_all.next()).unwrap().emergency().unwrap();
    assert_eq!((got.drive.position, got.emergency), (0, alarm));
    texts.push(got.text);
    for code in [0x7320, 0x3220] {
        line.inject(1, &[Emergency { code, ..alarm }], now);
        texts.push(rig.until(of_all.next()).unwrap().emergency().unwrap().text);
    }
    assert_eq!(
        texts,
        [
            "alarm A.710",
            "position; a text of this drive",
            "DC link under-voltage"
        ]
    );
}

#[test]
fn what_a_drive_sends_while_its_cable_is_out_comes_once_when_it_is_back() {
    let (line, mut rig) = drives_in_op(2);
    let events = rig.net.events();
    for round in 0..3 {
        line.with_segment(|segment| segment.unplug(1));
        let lost = rig.until(events.next()).unwrap();
        assert!(
            matches!(lost, NetworkEvent::Lost(ref drive) if drive.position == 1),
            "{lost}"
        );
        inject(&line, &rig, 1, 10 * round..10 * round + 3);
        inject(&line, &rig, 0, round..round + 1);
        rig.run_for(50 * MS);
        assert_eq!(
            waiting(&rig.emergencies(0)),
            numbers(0, round..round + 1),
            "the other goes on"
        );
        assert_eq!(waiting(&rig.emergencies(1)), []);
        line.with_segment(Segment::plug);
        rig.run_for(50 * MS);
        let got = waiting(&rig.emergencies(1));
        // Its watchdog has told of the loss besides.
        let ours: Vec<_> = got
            .iter()
            .filter(|report| !matches!(report, Ok((_, emergency)) if emergency.code == 0x8130))
            .copied()
            .collect();
        assert_eq!(ours, numbers(1, 10 * round..10 * round + 3));
        while events.try_next().is_some() {}
    }
}

#[test]
fn the_stream_ends_with_the_network() {
    let (line, mut rig) = drives_in_op(1);
    inject(&line, &rig, 0, 0..2);
    rig.run_for(20 * MS);
    let (mut one, mut all) = (
        rig.emergencies(0).stream(),
        rig.net.all_emergencies().stream(),
    );
    drop(rig.net);
    rig.bus.run();
    for stream in [
        &mut one as &mut (dyn smol::stream::Stream<Item = _> + Unpin),
        &mut all,
    ] {
        let reports: Vec<_> = smol::block_on(stream.collect());
        assert_eq!(reports.len(), 2);
    }
}

#[test]
fn a_fault_that_ends_a_move_names_the_emergencys_code() {
    let (line, mut rig) = drives_in_op(1);
    let axis = rig.net.axis("0").unwrap();
    rig.until(axis.enable()).unwrap();
    let mode = rig.until(axis.profile_position()).unwrap();
    let motion = rig
        .until(mode.move_rel(1_000_000, SetPoint::new()))
        .unwrap();
    line.with_segment(|segment| segment.axis_mut(0, 0).unwrap().inject_fault(0x8611));
    let error = rig.until(motion.done()).unwrap_err();
    assert!(
        matches!(
            error.kind,
            AxisErrorKind::Failed(Failure::Fault {
                code: Some(0x8611),
                following_error: false
            })
        ),
        "603Fh is not mapped: {error}"
    );
    let emergencies = rig.emergencies(0);
    let first = rig.until(emergencies.next()).unwrap().emergency().unwrap();
    assert_eq!(first.emergency.code, 0x8611);
}
