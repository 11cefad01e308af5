//! The client against a scripted device in virtual time.

use super::*;
use crate::coe::test_device::{Device, Fault, Rig, emergency, rig, rig_with};
use crate::coe::{AbortCode, DriveError, Emergencies, EmergencyReport, SdoError, obj};
use proptest::prelude::*;
use std::collections::VecDeque;

mod doubt;
mod information;

const VELOCITY: (u16, u8) = (0x6081, 0);

fn read_statusword(rig: &Rig, handle: &SdoHandle) -> Result<u16, DriveError> {
    let handle = handle.clone();
    rig.run(async move { handle.read(obj::STATUSWORD).await })
}

fn write_velocity(rig: &Rig, handle: &SdoHandle, value: u32) -> Result<(), DriveError> {
    let handle = handle.clone();
    rig.run(async move { handle.write(obj::PROFILE_VELOCITY, value).await })
}

fn codes(emergencies: &Emergencies) -> Vec<u16> {
    std::iter::from_fn(|| emergencies.try_next())
        .map(|report| report.emergency().expect("none is lost").emergency.code)
        .collect()
}

/// A device with statusword 1637h, and its client.
fn device_with_statusword() -> (Rig, Device, SdoHandle, Emergencies) {
    let all = rig();
    all.1.set(0x6041, 0, &[0x37, 0x16]);
    all
}

#[test]
fn typed_values_are_read_and_written() {
    let (rig, device, handle, _) = device_with_statusword();
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
    assert_eq!(write_velocity(&rig, &handle, 200_000), Ok(()));
    assert_eq!(
        device.0.borrow().written,
        [(0x6081, 0, vec![0x40, 0x0D, 3, 0])]
    );
}

#[test]
fn however_many_requests_did_not_reach_the_device_the_next_one_is_not_taken_for_its_last() {
    for missed in 0..16 {
        let (rig, device, handle, _) = device_with_statusword();
        assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
        device.0.borrow_mut().absent = true;
        for _ in 0..missed {
            assert!(read_statusword(&rig, &handle).is_err());
        }
        device.0.borrow_mut().absent = false;
        assert_eq!(read_statusword(&rig, &handle), Ok(0x1637), "{missed}");
    }
}

#[test]
fn the_first_answer_of_a_device_that_began_anew_is_not_taken_for_a_repeated_one() {
    let (rig, device, handle, _) = device_with_statusword();
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
    // Nobody knows whether it saw that its message was asked for again.
    let lost = Some(Fault::LostBefore);
    let faults = [None, lost, None, lost, lost, lost, lost];
    device.0.borrow_mut().faults = faults.into();
    let other = handle.clone();
    let read = async move { other.read(obj::PROFILE_VELOCITY).await };
    assert!(rig.run(read).is_err());
    device.0.borrow_mut().begin_anew();
    rig.signal.begin_anew();
    // The same bytes as its first answer of all.
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
}

#[test]
fn an_object_of_another_width_is_an_error_and_no_number() {
    let (rig, device, handle, _) = rig();
    device.set(0x6041, 0, &[1, 2, 3, 4]);
    let error = read_statusword(&rig, &handle).unwrap_err().error;
    assert!(matches!(
        error,
        SdoError::WrongSize {
            expected: 2,
            got: 4,
            ..
        }
    ));
}

#[test]
fn an_abort_tells_drive_object_and_reason() {
    let (rig, _, handle, _) = rig();
    let error = read_statusword(&rig, &handle).unwrap_err();
    assert_eq!(error.drive.position, 3);
    assert_eq!(error.error.abort_code(), Some(AbortCode::NO_OBJECT));
    assert_eq!(error.error.transfer().object, obj::STATUSWORD.address());
}

#[test]
fn an_emergency_before_a_reply_is_delivered_and_the_reply_used() {
    let (rig, device, handle, emergencies) = device_with_statusword();
    device.0.borrow_mut().before_reply = vec![emergency(0x7320), emergency(0x3220)];
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
    assert_eq!(codes(&emergencies), [0x7320, 0x3220]);
}

#[test]
fn an_emergency_in_place_of_a_reply_is_delivered_and_the_transfer_times_out() {
    let (rig, device, handle, emergencies) = device_with_statusword();
    device.0.borrow_mut().before_reply = vec![emergency(0x8611)];
    device.0.borrow_mut().swallow = 1;
    let error = read_statusword(&rig, &handle).unwrap_err().error;
    assert!(matches!(
        error,
        SdoError::Timeout {
            step: SdoStep::Reply,
            ..
        }
    ));
    assert_eq!(codes(&emergencies), [0x8611]);
    assert_eq!(
        read_statusword(&rig, &handle),
        Ok(0x1637),
        "the mailbox is in order afterwards"
    );
}

#[test]
fn emergencies_are_collected_while_nothing_is_asked() {
    let (rig, device, _handle, emergencies) = rig();
    device.post(&emergency(0x4210));
    rig.pass(Duration::from_millis(20));
    let seen = emergencies.try_next().unwrap().emergency().unwrap();
    assert_eq!(seen.emergency.code, 0x4210);
    assert!(seen.at <= Duration::from_millis(10));
}

#[test]
fn a_watched_mailbox_is_left_alone_until_a_mail_is_seen_in_it() {
    let (rig, device, handle, emergencies) = device_with_statusword();
    rig.signal.observe(false);
    rig.pass(Duration::from_millis(20));
    let before = device.0.borrow().accesses;
    device.post(&emergency(0x7320));
    for _ in 0..100 {
        rig.signal.observe(false);
        rig.pass(Duration::from_millis(1));
    }
    assert_eq!(device.0.borrow().accesses, before, "nobody has seen it");
    rig.signal.observe(true);
    rig.pass(Duration::from_millis(1));
    assert_eq!(codes(&emergencies), [0x7320]);
    let after = before + 2;
    assert_eq!(device.0.borrow().accesses, after, "a reading and a look");
    // A request goes on as ever, and takes what waits with it.
    device.post(&emergency(0x3220));
    rig.signal.observe(true);
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
    rig.pass(Duration::from_millis(20));
    assert_eq!(codes(&emergencies), [0x3220]);
    rig.signal.end();
    device.post(&emergency(0x8611));
    rig.pass(Duration::from_millis(20));
    assert_eq!(codes(&emergencies), [0x8611], "the client looks again");
}

#[test]
fn a_mail_that_was_seen_is_delivered_once_though_its_reading_is_lost() {
    for fault in [Fault::LostAfter, Fault::LostBefore, Fault::Twice] {
        let (rig, device, _handle, emergencies) = rig();
        rig.signal.observe(false);
        rig.pass(Duration::from_millis(20));
        for code in [0x7320, 0x3220] {
            let mut counted = emergency(code);
            counted[5] |= if code == 0x7320 { 0x10 } else { 0x20 };
            device.post(&counted);
            device.0.borrow_mut().faults = VecDeque::from([Some(fault)]);
            for _ in 0..300 {
                let waits = device.0.borrow_mut().status().mail_waiting;
                rig.signal.observe(waits);
                rig.pass(Duration::from_millis(1));
            }
            assert_eq!(codes(&emergencies), [code], "{fault:?}");
        }
    }
}

#[test]
fn a_full_queue_keeps_the_oldest_emergencies_and_tells_how_many_others_there_were() {
    let (rig, device, _handle, emergencies) = rig();
    for code in 1..=5 {
        device.post(&emergency(code));
    }
    rig.pass(Duration::from_millis(20));
    let kept: Vec<_> = (0..3)
        .filter_map(|_| emergencies.try_next()?.emergency())
        .collect();
    assert_eq!(
        kept.iter().map(|e| e.emergency.code).collect::<Vec<_>>(),
        [1, 2, 3]
    );
    assert_eq!(
        emergencies.try_next(),
        Some(EmergencyReport::Overflow { lost: 2 })
    );
    assert_eq!(emergencies.try_next(), None);
}

#[test]
fn a_device_that_sends_without_end_costs_the_transfer_and_no_more() {
    let (rig, device, handle, emergencies) = device_with_statusword();
    device.0.borrow_mut().flood = Some(emergency(0x8611));
    let error = read_statusword(&rig, &handle).unwrap_err().error;
    assert!(matches!(error, SdoError::Timeout { .. }), "{error}");
    let reports: Vec<_> = std::iter::from_fn(|| emergencies.try_next()).collect();
    assert!(
        matches!(reports[..], [.., EmergencyReport::Overflow { lost }] if lost > 0),
        "{reports:?}"
    );
    device.0.borrow_mut().flood = None;
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
}

#[test]
fn the_late_reply_of_a_timed_out_request_is_not_taken_for_another_objects() {
    let (rig, device, handle, _) = device_with_statusword();
    device.set(0x6064, 0, &[1, 0, 0, 0]);
    device.0.borrow_mut().delays = VecDeque::from([Duration::from_millis(1500)]);
    assert!(read_statusword(&rig, &handle).is_err());
    let later = handle.clone();
    let position = rig.run(async move { later.read(obj::POSITION_ACTUAL).await });
    assert_eq!(position, Ok(1));
}

#[test]
fn the_late_confirmation_of_a_write_does_not_confirm_the_next_write_of_that_object() {
    let (rig, device, handle, _) = rig();
    device.0.borrow_mut().delays = VecDeque::from([Duration::from_millis(1500)]);
    let error = write_velocity(&rig, &handle, 1).unwrap_err().error;
    assert!(matches!(error, SdoError::Timeout { .. }));
    device.0.borrow_mut().refused.insert(VELOCITY, 0x0800_0022);
    let error = write_velocity(&rig, &handle, 2).unwrap_err().error;
    assert_eq!(error.abort_code(), Some(AbortCode::PRESENT_STATE));
}

#[test]
fn no_late_reply_is_taken_after_several_requests_have_timed_out() {
    // Both late replies are still to come when the first object is written again.
    let (rig, device, handle, _) = device_with_statusword();
    device.0.borrow_mut().delays = VecDeque::from([Duration::from_millis(2500), Duration::ZERO]);
    assert!(write_velocity(&rig, &handle, 1).is_err());
    assert!(read_statusword(&rig, &handle).is_err());
    device.0.borrow_mut().refused.insert(VELOCITY, 0x0800_0022);
    let error = write_velocity(&rig, &handle, 2).unwrap_err().error;
    assert_eq!(error.abort_code(), Some(AbortCode::PRESENT_STATE));
}

#[test]
fn a_write_without_reply_is_not_written_again() {
    let (rig, device, handle, _) = rig();
    device.0.borrow_mut().swallow = 1;
    let error = write_velocity(&rig, &handle, 5).unwrap_err().error;
    assert!(matches!(error, SdoError::Timeout { .. }), "{error}");
    rig.pass(Duration::from_secs(3));
    assert_eq!(device.0.borrow().written.len(), 1);
}

#[test]
fn a_callers_future_can_be_dropped_at_any_moment() {
    let name: Vec<u8> = (0..100).collect();
    for moment in 0..120 {
        let (rig, device, handle, _) = device_with_statusword();
        device.set(0x1008, 0, &name);
        let (clock, leaver, data) = (rig.clock.clone(), handle.clone(), name.clone());
        rig.run(async move {
            let work = async {
                drop(leaver.read(obj::DEVICE_NAME).await);
                drop(leaver.write_bytes(0x2001, 0, data).await);
            };
            let time = Duration::from_micros(50 * moment);
            or(work, clock.sleep_until(time)).await;
        });
        assert_eq!(read_statusword(&rig, &handle), Ok(0x1637), "{moment}");
        let written = device.0.borrow().written.clone();
        assert!(written.iter().all(|(_, _, data)| *data == name), "{moment}");
    }
}

#[test]
fn several_tasks_share_one_drive() {
    let (rig, device, handle, _) = device_with_statusword();
    for index in 0..20u16 {
        device.set(0x2000 + index, 0, &(0..index as u8 * 3).collect::<Vec<_>>());
    }
    let read = |index: u16| {
        let handle = handle.clone();
        async move { (index, handle.read_bytes(0x2000 + index, 0).await) }
    };
    let tasks: Vec<_> = (0..20).map(read).collect();
    let results = rig.run(async move {
        let executor = smol::LocalExecutor::new();
        let running: Vec<_> = tasks.into_iter().map(|task| executor.spawn(task)).collect();
        executor
            .run(async move {
                let mut results = Vec::new();
                for task in running {
                    results.push(task.await);
                }
                results
            })
            .await
    });
    for (index, result) in results {
        let expected: Vec<u8> = (0..index as u8 * 3).collect();
        assert_eq!(result, Ok(expected), "{index}");
    }
}

#[test]
fn a_reply_whose_reading_was_lost_is_asked_for_again() {
    for fault in [Fault::LostAfter, Fault::LostBefore, Fault::Twice] {
        let (rig, device, handle, emergencies) = device_with_statusword();
        // Accesses: write, status, read.
        device.0.borrow_mut().faults = VecDeque::from([None, None, Some(fault)]);
        assert_eq!(read_statusword(&rig, &handle), Ok(0x1637), "{fault:?}");
        assert_eq!(device.0.borrow().served, 1, "{fault:?}");
        assert!(emergencies.try_next().is_none());
        assert_eq!(read_statusword(&rig, &handle), Ok(0x1637), "{fault:?}");
    }
}

#[test]
fn an_emergency_is_delivered_once_though_its_mail_was_repeated() {
    let (rig, device, handle, emergencies) = device_with_statusword();
    let mut counted = emergency(0x7320);
    counted[5] |= 0x50;
    device.0.borrow_mut().before_reply = vec![counted];
    // The emergency is read by the second access, behind the request; the third shows that a message waits, and the reading
    // of the reply is lost before the device, which then repeats the emergency.
    device.0.borrow_mut().faults = VecDeque::from([None, None, None, Some(Fault::LostBefore)]);
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
    assert_eq!(codes(&emergencies), [0x7320]);
}

#[test]
fn a_request_whose_frame_was_lost_is_carried_out_once() {
    for fault in [Fault::LostBefore, Fault::LostAfter, Fault::Twice] {
        let (rig, device, handle, _) = rig();
        device.0.borrow_mut().faults = VecDeque::from([Some(fault)]);
        assert_eq!(write_velocity(&rig, &handle, 7), Ok(()), "{fault:?}");
        assert_eq!(device.0.borrow().written.len(), 1, "{fault:?}");
    }
}

#[test]
fn any_single_fault_leaves_segmented_transfers_whole() {
    let name: Vec<u8> = (0..100).collect();
    let run = |faults: VecDeque<Option<Fault>>| {
        let (rig, device, handle, _) = rig();
        device.set(0x1008, 0, &name);
        device.0.borrow_mut().faults = faults;
        let data = name.clone();
        let result = rig.run(async move {
            let read = handle.read(obj::DEVICE_NAME).await?;
            handle.write_bytes(0x2001, 0, data).await?;
            Ok::<_, DriveError>(read)
        });
        let state = device.0.borrow();
        (result, state.written.clone(), state.accesses)
    };
    let expected = [(0x2001, 0, name.clone())];
    let (_, _, accesses) = run(VecDeque::new());
    assert!(accesses > 12);
    for place in 0..accesses {
        for fault in [Fault::LostBefore, Fault::LostAfter, Fault::Twice] {
            let mut faults = VecDeque::from(vec![None; place]);
            faults.push_back(Some(fault));
            let (result, written, _) = run(faults);
            assert_eq!(result, Ok(name.clone()), "{fault:?} of access {place}");
            assert_eq!(written, expected, "{fault:?} of access {place}");
        }
    }
}

#[test]
fn there_is_room_for_the_longest_answer_from_the_second_time_on() {
    let (rig, device, handle, _) = rig();
    device.set(0x1008, 0, &[7; 10_000]);
    assert!(handle.calls.room() < 10_000);
    let sdo = handle.clone();
    let read = rig.run(async move { sdo.read_bytes(0x1008, 0).await });
    assert_eq!(read, Ok(vec![7; 10_000]));
    assert_eq!(handle.calls.room(), 10_000);
}

#[test]
fn a_full_mailbox_is_waited_for() {
    let (rig, device, handle, _) = device_with_statusword();
    device.0.borrow_mut().takes_from = Duration::from_millis(300);
    let first = handle.clone().with_timeout(Duration::from_millis(50));
    assert!(read_statusword(&rig, &first).is_err());
    assert_eq!(
        read_statusword(&rig, &handle),
        Ok(0x1637),
        "sent again until the device takes it"
    );
    assert!(rig.clock.now() >= Duration::from_millis(300));
}

#[test]
fn a_mailbox_that_stays_full_is_a_timeout_of_sending() {
    let (rig, device, handle, _) = rig();
    device.0.borrow_mut().takes_from = Duration::MAX;
    let blocked = rig.run({
        let handle = handle.clone();
        async move { handle.read(obj::DEVICE_TYPE).await }
    });
    assert!(matches!(
        blocked.unwrap_err().error,
        SdoError::Timeout {
            step: SdoStep::Reply,
            ..
        }
    ));
    let error = read_statusword(&rig, &handle).unwrap_err().error;
    assert!(
        matches!(
            error,
            SdoError::Timeout {
                step: SdoStep::Sending,
                ..
            }
        ),
        "{error}"
    );
}

#[test]
fn a_dead_link_ends_a_transfer_in_bounded_time() {
    let (rig, device, handle, _) = rig();
    device.0.borrow_mut().faults = VecDeque::from(vec![Some(Fault::LostBefore); 1000]);
    let error = read_statusword(&rig, &handle).unwrap_err().error;
    assert!(matches!(error, SdoError::Link { .. }), "{error}");
    assert!(rig.clock.now() < Duration::from_secs(2));
}

#[test]
fn a_caller_that_goes_away_leaves_the_mailbox_in_order() {
    let (rig, device, handle, _) = device_with_statusword();
    let name: Vec<u8> = (0..100).collect();
    device.0.borrow_mut().delays = VecDeque::from(vec![Duration::from_millis(20); 5]);
    let (clock, leaver, data) = (rig.clock.clone(), handle.clone(), name.clone());
    rig.run(async move {
        let write = async {
            leaver.write_bytes(0x2001, 0, data).await.unwrap();
            panic!("the caller did not go away");
        };
        or(write, clock.sleep_until(Duration::from_millis(5))).await;
    });
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
    assert_eq!(
        device.0.borrow().written,
        [(0x2001, 0, name)],
        "what had begun was completed"
    );
}

#[test]
fn a_request_that_has_not_begun_is_withdrawn_with_its_caller() {
    let (rig, device, handle, _) = device_with_statusword();
    device.0.borrow_mut().delays = VecDeque::from([Duration::from_millis(20)]);
    let (clock, first, second) = (rig.clock.clone(), handle.clone(), handle.clone());
    let value = rig.run(async move {
        let leaver = async {
            or(
                async { drop(second.write(obj::PROFILE_VELOCITY, 1).await) },
                clock.sleep_until(Duration::from_millis(5)),
            )
            .await;
        };
        smol::future::zip(first.read(obj::STATUSWORD), leaver)
            .await
            .0
    });
    assert_eq!(value, Ok(0x1637));
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
    assert!(device.0.borrow().written.is_empty());
}

#[test]
fn a_request_after_the_client_has_gone_is_refused_and_does_not_hang() {
    let (rig, _, handle, _) = rig();
    drop(rig);
    let result = smol::block_on(handle.read(obj::STATUSWORD));
    assert!(matches!(result.unwrap_err().error, SdoError::Closed { .. }));
}

proptest! {
    #[test]
    fn no_mails_make_the_client_panic_or_hang(mails in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..32), 0..8)) {
        let (rig, device, handle, _) = device_with_statusword();
        device.0.borrow_mut().before_reply = mails;
        let _ = read_statusword(&rig, &handle);
        rig.pass(Duration::from_millis(100));
        prop_assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
    }

    #[test]
    fn headed_mails_of_any_content_do_no_harm(kinds in prop::collection::vec((0u8..16, any::<u8>(), any::<[u8; 10]>()), 0..6)) {
        let (rig, device, handle, _) = device_with_statusword();
        device.0.borrow_mut().before_reply = kinds
            .into_iter()
            .map(|(kind, service, payload)| {
                let mut mail = vec![12, 0, 0, 0, 0, kind, 0, service];
                mail.extend(payload);
                mail
            })
            .collect();
        let _ = read_statusword(&rig, &handle);
        rig.pass(Duration::from_millis(100));
        prop_assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
    }
}
