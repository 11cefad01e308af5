use std::collections::VecDeque;

use proptest::prelude::*;

use super::*;
use crate::coe::information::ListKind;
use crate::coe::mailbox::MailboxError;
use crate::coe::test_device::{Device, Fault, Rig, emergency, rig, rig_with};
use crate::coe::{
    AbortCode, DriveError, Emergencies, EmergencyReport, NoInformation, ObjectAddress, SdoError,
    TransferKind, TypeCode, obj,
};

// The client against a scripted device in virtual time.

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
fn a_timeout_without_an_end_is_a_deadline_that_never_comes() {
    let (rig, _, handle, _) = device_with_statusword();
    rig.pass(Duration::from_millis(20));
    let patient = handle.with_timeout(Duration::MAX);
    assert_eq!(read_statusword(&rig, &patient), Ok(0x1637));
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
fn a_watched_mailbox_is_left_alone_until_a_message_is_seen_in_it() {
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
fn a_message_that_was_seen_is_delivered_once_though_its_reading_is_lost() {
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
                let waits = device.0.borrow_mut().status().message_waiting;
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
fn an_emergency_is_delivered_once_though_its_message_was_repeated() {
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
fn a_confirmation_that_a_device_without_a_counter_repeats_is_not_that_of_the_next_write() {
    let (rig, device, handle, _) = rig();
    device.0.borrow_mut().counts_nothing = true;
    assert_eq!(write_velocity(&rig, &handle, 7), Ok(()));
    // The reading of the confirmation is lost before the device, which then repeats the one of before; it has
    // refused the new write.
    {
        let mut state = device.0.borrow_mut();
        state.refused.insert(VELOCITY, 0x0800_0022);
        state.faults = VecDeque::from([None, Some(Fault::LostBefore)]);
    }
    let error = write_velocity(&rig, &handle, 8).unwrap_err().error;
    assert_eq!(error.abort_code(), Some(AbortCode::PRESENT_STATE));
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
    assert!(handle.room().capacity() < 10_000);
    let sdo = handle.clone();
    let read = rig.run(async move { sdo.read_bytes(0x1008, 0).await });
    assert_eq!(read, Ok(vec![7; 10_000]));
    assert_eq!(handle.room().capacity(), 10_000);
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
    fn no_messages_make_the_client_panic_or_hang(messages in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..32), 0..8)) {
        let (rig, device, handle, _) = device_with_statusword();
        device.0.borrow_mut().before_reply = messages;
        let _ = read_statusword(&rig, &handle);
        rig.pass(Duration::from_millis(100));
        prop_assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
    }

    #[test]
    fn headed_messages_of_any_content_do_no_harm(kinds in prop::collection::vec((0u8..16, any::<u8>(), any::<[u8; 10]>()), 0..6)) {
        let (rig, device, handle, _) = device_with_statusword();
        device.0.borrow_mut().before_reply = kinds
            .into_iter()
            .map(|(kind, service, payload)| {
                let mut message = vec![12, 0, 0, 0, 0, kind, 0, service];
                message.extend(payload);
                message
            })
            .collect();
        let _ = read_statusword(&rig, &handle);
        rig.pass(Duration::from_millis(100));
        prop_assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
    }
}

// A write whose frame is lost, on devices that do not look at the mailbox counter; error replies that come late.

/// What a write's lost frame, the following accesses' fates and the device make of it.
fn written_with(faults: &[Option<Fault>], delay: Duration) -> (Result<(), DriveError>, usize) {
    let (rig, device, handle, _) = rig();
    {
        let mut state = device.0.borrow_mut();
        state.ignores_counter = true;
        state.faults = faults.iter().copied().collect();
        state.delays = VecDeque::from([delay]);
    }
    let result = write_velocity(&rig, &handle, 7);
    rig.pass(Duration::from_secs(3));
    let count = device.0.borrow().written.len();
    (result, count)
}

#[test]
fn a_write_whose_frame_is_lost_is_carried_out_once_by_a_device_that_does_not_count() {
    for fault in [Fault::LostBefore, Fault::LostAfter] {
        for delay in [0, 5, 30, 300, 900].map(Duration::from_millis) {
            let (result, count) = written_with(&[Some(fault)], delay);
            assert_eq!(
                (result, count),
                (Ok(()), 1),
                "{fault:?}, answered after {delay:?}"
            );
        }
    }
}

#[test]
fn a_write_that_the_device_may_have_taken_before_it_was_in_init_is_not_sent_again() {
    let (rig, device, handle, _) = rig();
    {
        let mut state = device.0.borrow_mut();
        state.faults = VecDeque::from([Some(Fault::LostAfter)]);
        state.delays = VecDeque::from([Duration::from_millis(500)]);
    }
    let (clock, signal, falls) = (rig.clock.clone(), rig.signal.clone(), device.clone());
    let init = async move {
        // The frame has counted as lost for 10 ms.
        clock.sleep_until(Duration::from_millis(160)).await;
        falls.0.borrow_mut().begin_anew();
        signal.begin_anew();
    };
    let written = async move { handle.write(obj::PROFILE_VELOCITY, 7_u32).await };
    let (result, ()) = rig.run(smol::future::zip(written, init));
    let error = result.unwrap_err().error;
    assert!(matches!(error, SdoError::Timeout { .. }), "{error}");
    assert_eq!(device.0.borrow().written.len(), 1);
}

#[test]
fn whatever_else_is_lost_besides_the_write_it_is_never_carried_out_twice() {
    let fates = [None, Some(Fault::LostBefore), Some(Fault::LostAfter)];
    for first in [Fault::LostBefore, Fault::LostAfter] {
        for place in 0..8 {
            for fate in fates {
                let mut faults = vec![Some(first)];
                faults.resize(1 + place, None);
                faults.push(fate);
                let (result, count) = written_with(&faults, Duration::ZERO);
                assert_eq!((result, count), (Ok(()), 1), "{faults:?}");
            }
        }
    }
}

#[test]
fn a_doubtful_write_that_the_device_refuses_is_refused() {
    for fault in [Fault::LostBefore, Fault::LostAfter] {
        let (rig, device, handle, _) = rig();
        {
            let mut state = device.0.borrow_mut();
            state.refused.insert(VELOCITY, 0x0800_0022);
            state.faults = VecDeque::from([Some(fault)]);
        }
        let error = write_velocity(&rig, &handle, 7).unwrap_err().error;
        assert_eq!(
            error.abort_code(),
            Some(AbortCode::PRESENT_STATE),
            "{fault:?}"
        );
    }
}

#[test]
fn a_doubtful_write_to_a_device_that_says_nothing_any_more_is_told_as_not_answered() {
    let (rig, device, handle, _) = rig();
    {
        let mut state = device.0.borrow_mut();
        state.faults = VecDeque::from([Some(Fault::LostAfter)]);
        state.swallow = usize::MAX;
    }
    let error = write_velocity(&rig, &handle, 7).unwrap_err().error;
    assert!(matches!(error, SdoError::Timeout { .. }), "{error}");
    assert_eq!(error.transfer().object.index, 0x6081);
    assert_eq!(device.0.borrow().written.len(), 1);
}

#[test]
fn a_second_answer_to_a_request_that_was_sent_again_is_not_taken_for_that_of_the_next() {
    // The device takes the reading twice, and its second answer is late.
    let (rig, device, handle, _) = device_with_statusword();
    {
        let mut state = device.0.borrow_mut();
        state.ignores_counter = true;
        state.faults = VecDeque::from([Some(Fault::LostAfter), None]);
        state.delays = [300, 500].map(Duration::from_millis).into();
    }
    let first = handle.clone();
    assert_eq!(read_statusword(&rig, &first), Ok(0x1637));
    assert_eq!(device.0.borrow().served, 2, "it was taken twice");
    device.set(0x6041, 0, &[0x50, 0x02]);
    assert_eq!(read_statusword(&rig, &handle), Ok(0x0250));
}

#[test]
fn a_late_error_reply_of_the_mailbox_does_not_end_the_next_request() {
    let (rig, device, handle, _) = device_with_statusword();
    // The question is answered by an error of the mailbox, after its deadline.
    device.0.borrow_mut().delays = VecDeque::from([Duration::from_millis(1500)]);
    let asks = handle.clone();
    let unanswered = rig.run(async move { asks.dictionary().await }).unwrap_err();
    assert!(
        matches!(unanswered.error, SdoError::Timeout { .. }),
        "{unanswered}"
    );
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
}

#[test]
fn an_error_reply_after_which_nothing_comes_is_the_requests_own() {
    let (rig, device, handle, _) = rig();
    device.0.borrow_mut().swallow = 1;
    assert!(read_statusword(&rig, &handle).is_err());
    let asks = handle.clone();
    let refused = rig.run(async move { asks.dictionary().await }).unwrap_err();
    assert!(
        matches!(refused.error, SdoError::NotSupported { .. }),
        "{refused}"
    );
}

// SDO information through the client.

/// One fragment of an answer, behind the CoE header.
fn fragment(operation: u8, left: u16, data: &[u8]) -> Vec<u8> {
    let more = if left > 0 { 0x80 } else { 0 };
    let [l0, l1] = left.to_le_bytes();
    [&[operation | more, 0, l0, l1], data].concat()
}

fn whole(operation: u8, data: &[u8]) -> Vec<Vec<u8>> {
    vec![fragment(operation, 0, data)]
}

fn refused(code: u32) -> Vec<Vec<u8>> {
    whole(7, &code.to_le_bytes())
}

fn entry(index: u16, subindex: u8, name: &str) -> Vec<Vec<u8>> {
    let [i0, i1] = index.to_le_bytes();
    let head = [i0, i1, subindex, 7, 6, 0, 16, 0, 0x3F, 0];
    whole(6, &[&head[..], name.as_bytes()].concat())
}

/// Three fragments: 6040h, 1018h, 6041h, 6060h.
fn list() -> Vec<Vec<u8>> {
    vec![
        fragment(2, 2, &[1, 0, 0x40, 0x60]),
        fragment(2, 1, &[0x18, 0x10, 0x41]),
        fragment(2, 0, &[0x60, 0x60, 0x60]),
    ]
}

fn read_list(rig: &Rig, handle: &SdoHandle) -> Result<Vec<u16>, SdoError> {
    let handle = handle.clone();
    rig.run(async move { handle.object_list(ListKind::All).await })
        .map_err(|error| error.error)
}

const LIST: [u16; 4] = [0x6040, 0x1018, 0x6041, 0x6060];

#[test]
fn a_dictionary_is_read_with_what_the_drive_refuses_told_apart() {
    let (rig, device, handle, _) = rig();
    let variable = |index: u16, name: &[u8]| {
        let [i0, i1] = index.to_le_bytes();
        whole(4, &[&[i0, i1, 6, 0, 0, 7], name].concat())
    };
    device.0.borrow_mut().information = VecDeque::from([
        list(),
        variable(0x6040, b"Controlword"),
        entry(0x6040, 0, ""),
        // A record with a gap, and with an entry that is refused.
        whole(4, b"\x18\x10\x23\x00\x03\x09Identity"),
        entry(0x1018, 0, "Count"),
        refused(0x0609_0011),
        entry(0x1018, 2, "Product"),
        refused(0x0800_0000),
        refused(0x0800_0000),
        // An object that is listed and not there.
        refused(0x0602_0000),
        variable(0x6060, b"Mode"),
        // An entry that cannot be told with limits is asked for without them.
        refused(0x0607_0010),
        entry(0x6060, 0, "Mode"),
    ]);
    let asked = handle.clone();
    let dictionary = rig.run(async move { asked.dictionary().await }).unwrap();
    let indices = dictionary.objects.iter().map(|o| o.description.index);
    assert_eq!(indices.collect::<Vec<_>>(), [0x6040, 0x1018, 0x6060]);
    let identity: Vec<_> = dictionary.object(0x1018).unwrap().entries.iter().collect();
    let subindices = identity.iter().map(|entry| entry.address.subindex);
    assert_eq!(subindices.collect::<Vec<_>>(), [0, 2]);
    let told: Vec<_> = dictionary
        .undescribed
        .iter()
        .map(|lacking| (lacking.index, lacking.subindex, lacking.code.0))
        .collect();
    assert_eq!(
        told,
        [(0x1018, Some(3), 0x0800_0000), (0x6041, None, 0x0602_0000)]
    );
    let named: Vec<_> = dictionary.named("controlWORD").collect();
    assert_eq!(named[0].address, ObjectAddress::new(0x6040, 0));
    assert_eq!((named.len(), named[0].data_type), (1, TypeCode(6)));
    assert_eq!(dictionary.named("mode").count(), 1);
    assert!(device.0.borrow().information.is_empty());
}

#[test]
fn a_dictionary_that_does_not_end_is_given_up_at_its_bound() {
    let described = |name: &str| {
        VecDeque::from([
            whole(2, &[1, 0, 0x18, 0x10]),
            whole(4, b"\x18\x10\x23\x00\x01\x09Identity"),
            entry(0x1018, 0, name),
            refused(0x0800_0000),
            refused(0x0800_0000),
        ])
    };
    let (rig, device, handle, _) = rig();
    let mut needed = 0;
    for (more, name) in [(0, ""), (5, "Count")] {
        let taken = (0..1000).find(|most| {
            device.0.borrow_mut().information = described(name);
            let (asked, most) = (handle.clone(), *most);
            match rig.run(async move { asked.dictionary_within(most).await }) {
                Ok(dictionary) => !dictionary.objects.is_empty(),
                Err(DriveError { error, .. }) => {
                    let SdoError::WrongSize { expected, got, .. } = error else {
                        panic!("{error}")
                    };
                    assert_eq!(expected, most);
                    assert!(got > most);
                    false
                }
            }
        });
        let taken = taken.unwrap();
        assert!(
            taken > 150,
            "{taken}: an object, an entry, and one that is refused"
        );
        assert!(more == 0 || taken == needed + more, "a name counts");
        needed = taken;
    }
}

#[test]
fn a_device_without_the_service_says_so_and_goes_on() {
    let (rig, device, handle, _) = device_with_statusword();
    let reason = |rig: &Rig| match read_list(rig, &handle) {
        Err(SdoError::NotSupported { reason, transfer }) => {
            assert_eq!(transfer.kind, TransferKind::List(ListKind::All));
            reason
        }
        other => panic!("{other:?}"),
    };
    assert_eq!(reason(&rig), NoInformation::MailboxMessage(MailboxError(4)));
    device.0.borrow_mut().information = VecDeque::from([refused(0x0504_0001)]);
    assert_eq!(reason(&rig), NoInformation::Service(AbortCode::COMMAND));
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
    // By an SDO abort; a message before the one that would answer.
    let abort = vec![10, 0, 0, 0, 0, 0x33, 0, 0x20, 0x80, 0, 0, 0, 1, 0, 4, 5];
    device.post(&abort);
    device.0.borrow_mut().information = VecDeque::from([vec![]]);
    assert_eq!(reason(&rig), NoInformation::Service(AbortCode::COMMAND));
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
}

#[test]
fn a_device_whose_sii_has_no_sdo_information_is_not_asked() {
    let (rig, device, handle, _) = rig_with(|settings| settings.sdo_information = false);
    assert!(matches!(
        read_list(&rig, &handle),
        Err(SdoError::NotSupported {
            reason: NoInformation::Sii,
            ..
        })
    ));
    assert_eq!(device.0.borrow().accesses, 0);
    device.set(0x6041, 0, &[0x37, 0x16]);
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
}

#[test]
fn a_refusal_in_the_middle_of_a_list_ends_it_and_nothing_more() {
    let (rig, device, handle, _) = device_with_statusword();
    let broken = vec![list().swap_remove(0), refused(0x0800_0000).swap_remove(0)];
    device.0.borrow_mut().information = VecDeque::from([broken, list()]);
    let error = read_list(&rig, &handle).unwrap_err();
    assert_eq!(error.abort_code(), Some(AbortCode(0x0800_0000)));
    assert_eq!(read_list(&rig, &handle), Ok(LIST.to_vec()));
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
}

#[test]
fn a_fragment_that_the_device_leaves_out_is_an_error_and_the_next_list_is_whole() {
    for missing in [1, 2] {
        let (rig, device, handle, _) = device_with_statusword();
        let mut broken = list();
        broken.remove(missing);
        device.0.borrow_mut().information = VecDeque::from([broken, list()]);
        let error = read_list(&rig, &handle).unwrap_err();
        let step = SdoStep::Fragment;
        let expected = match missing {
            1 => matches!(
                error,
                SdoError::Fragments {
                    expected: 1,
                    got: 0,
                    ..
                }
            ),
            _ => matches!(error, SdoError::Timeout { step: s, .. } if s == step),
        };
        assert!(expected, "{error}");
        assert_eq!(read_list(&rig, &handle), Ok(LIST.to_vec()));
    }
}

#[test]
fn late_fragments_are_not_taken_for_those_of_the_next_list() {
    let (rig, device, handle, _) = rig();
    device.0.borrow_mut().information = VecDeque::from([list(), list()]);
    device.0.borrow_mut().delays = VecDeque::from([Duration::from_millis(1500)]);
    assert!(matches!(
        read_list(&rig, &handle),
        Err(SdoError::Timeout { .. })
    ));
    assert_eq!(read_list(&rig, &handle), Ok(LIST.to_vec()));
}

#[test]
fn any_single_lost_frame_leaves_a_list_whole_and_a_doubled_one_makes_no_other() {
    let run = |faults: VecDeque<Option<Fault>>| {
        let (rig, device, handle, _) = rig();
        device.0.borrow_mut().information = VecDeque::from([list()]);
        device.0.borrow_mut().faults = faults;
        (read_list(&rig, &handle), device.0.borrow().accesses)
    };
    let (_, accesses) = run(VecDeque::new());
    assert!(accesses > 5);
    for place in 0..accesses {
        for fault in [Fault::LostBefore, Fault::LostAfter, Fault::Twice] {
            let mut faults = VecDeque::from(vec![None; place]);
            faults.push_back(Some(fault));
            let (result, _) = run(faults);
            // A frame that is doubled on its way reads two fragments, of which one is gone for good: no list, then.
            let gone = fault == Fault::Twice && result.is_err();
            assert!(gone || result == Ok(LIST.to_vec()), "{fault:?} of {place}");
        }
    }
}

#[test]
fn emergencies_and_sdo_replies_between_the_fragments_do_no_harm() {
    let (rig, device, handle, emergencies) = rig();
    device.0.borrow_mut().information = VecDeque::from([vec![list().swap_remove(0)]]);
    // The rest of the list comes behind an emergency and a foreign SDO reply.
    let later = handle.clone();
    let messages = device.clone();
    let clock = rig.clock.clone();
    let result = rig.run(async move {
        let posting = async {
            clock.sleep_until(Duration::from_millis(5)).await;
            messages.post(&emergency(0x7320));
            messages.post(&[
                10, 0, 0, 0, 0, 0x63, 0, 0x30, 0x4B, 0x41, 0x60, 0, 1, 2, 0, 0,
            ]);
            for fragment in &list()[1..] {
                let length = (fragment.len() + 2) as u8;
                let mut message = vec![length, 0, 0, 0, 0, 0x03, 0, 0x80];
                message.extend(fragment);
                messages.post(&message);
            }
        };
        smol::future::zip(later.object_list(ListKind::All), posting)
            .await
            .0
    });
    assert_eq!(result, Ok(LIST.to_vec()));
    assert_eq!(codes(&emergencies), [0x7320]);
}

proptest! {
    #[test]
    fn hostile_fragments_end_in_bounded_time_and_leave_the_mailbox_in_order(
        fragments in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..24), 0..6),
        headed in any::<bool>(),
    ) {
        let (rig, device, handle, _) = device_with_statusword();
        let hostile = fragments.into_iter().enumerate().map(|(at, mut body)| {
            if headed && body.len() > 6 {
                body[0] = 0x82;
                body[2..4].copy_from_slice(&(9 - at as u16).to_le_bytes());
            }
            body
        });
        device.0.borrow_mut().information = VecDeque::from([hostile.collect()]);
        let _ = read_list(&rig, &handle);
        prop_assert!(rig.clock.now() < Duration::from_secs(12));
        prop_assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
    }
}

fn given(counters: &mut Counters) -> u8 {
    counters.next().get()
}

#[test]
fn counters_go_round_while_messages_are_taken() {
    let mut counters = Counters::default();
    let all = (0..9).map(|_| {
        let next = given(&mut counters);
        counters.taken();
        next
    });
    assert_eq!(all.collect::<Vec<_>>(), [1, 2, 3, 4, 5, 6, 7, 1, 2]);
}

#[test]
fn the_counter_of_the_last_message_taken_is_passed_over() {
    let mut counters = Counters::default();
    given(&mut counters);
    counters.taken();
    let never_taken = (0..8).map(|_| given(&mut counters));
    assert_eq!(never_taken.collect::<Vec<_>>(), [2, 3, 4, 5, 6, 7, 2, 3]);
}

#[test]
fn so_are_those_of_messages_that_may_have_been_taken() {
    let mut counters = Counters::default();
    for perhaps in [1, 2, 3] {
        assert_eq!(given(&mut counters), perhaps);
        counters.perhaps_taken();
    }
    let others = (0..5).map(|_| given(&mut counters));
    assert_eq!(others.collect::<Vec<_>>(), [4, 5, 6, 7, 4]);
    counters.taken();
    assert_eq!(given(&mut counters), 5);
    // Where all seven are uncertain, one must be taken again.
    for _ in 0..9 {
        counters.perhaps_taken();
        assert!((1..=7).contains(&given(&mut counters)));
    }
}

const MS: Duration = Duration::from_millis(1);

#[test]
fn the_first_look_comes_before_the_answer_is_expected_and_never_late() {
    let mut poll_timing = PollTiming::default();
    assert!(poll_timing.is_quick());
    poll_timing.answered_after(2 * MS);
    assert!(!poll_timing.is_quick());
    assert_eq!(poll_timing.first_look(), MS * 3 / 2);
    poll_timing.answered_after(Duration::from_secs(3));
    assert_eq!(poll_timing.first_look(), 4 * MS);
}

#[test]
fn a_device_that_becomes_quick_is_soon_found_out() {
    let mut poll_timing = PollTiming::default();
    poll_timing.answered_after(2 * MS);
    let mut answers = 0;
    while !poll_timing.is_quick() {
        // It has answered by the first look.
        poll_timing.answered_after(poll_timing.first_look());
        answers += 1;
    }
    assert!(answers <= 12, "{answers}");
}

#[test]
fn pauses_grow_with_the_time_waited_up_to_the_longest() {
    let poll_timing = PollTiming::default();
    let longest = MS / 4;
    assert_eq!(poll_timing.pause(Duration::ZERO, longest), SHORTEST_PAUSE);
    assert_eq!(poll_timing.pause(2 * MS, longest), MS / 8);
    assert_eq!(poll_timing.pause(100 * MS, longest), longest);
}

/// A device that takes its requests in at once and is late with the answers to all of them.
#[test]
fn a_late_answer_confirms_no_write_also_where_each_object_that_could_be_asked_for_is_owed() {
    let (rig, device, handle, _) = rig();
    for (object, subindex) in [(0x1018, 1), (0x1018, 2)] {
        device.set(object, subindex, &[1, 0, 0, 0]);
    }
    let late = Duration::from_secs(10);
    device.0.borrow_mut().delays = VecDeque::from([late]);
    for (object, subindex) in [(0x1000, 0), (0x1018, 1), (0x1018, 2)] {
        let other = handle.clone();
        let read = async move { other.read_bytes(object, subindex).await };
        let error = rig.run(read).unwrap_err().error;
        assert!(matches!(error, SdoError::Timeout { .. }), "{error}");
    }
    let error = write_velocity(&rig, &handle, 100).unwrap_err().error;
    assert!(matches!(error, SdoError::Timeout { .. }), "{error}");
    assert_eq!(device.0.borrow().written.len(), 1);
    // From now on the device refuses it.
    device.0.borrow_mut().refused.insert(VELOCITY, 0x0609_0030);
    rig.pass(late - rig.clock.now() - Duration::from_millis(500));
    let again = write_velocity(&rig, &handle, 200);
    assert_eq!(device.0.borrow().written.len(), 1, "refused");
    assert!(
        again.is_err(),
        "{again:?}: 200 was not written, and counts as confirmed"
    );
}

/// What had failed before is no reason to leave a message where it is lost.
#[test]
fn an_emergency_whose_reading_is_lost_is_asked_for_again_also_after_a_transfer_that_failed() {
    for is_watched in [false, true] {
        let (rig, device, handle, emergencies) = device_with_statusword();
        if is_watched {
            rig.signal.observe(false);
        }
        device.0.borrow_mut().absent = true;
        let error = read_statusword(&rig, &handle).unwrap_err().error;
        assert!(matches!(error, SdoError::Link { .. }), "{error}");
        device.0.borrow_mut().absent = false;
        let mut counted = emergency(0x8611);
        counted[5] |= 0x10;
        device.post(&counted);
        let lost = Some(Fault::LostAfter);
        // Where nobody watches, the state of the mailbox is read before.
        let faults = if is_watched {
            vec![lost]
        } else {
            vec![None, lost]
        };
        device.0.borrow_mut().faults = faults.into();
        for _ in 0..300 {
            if is_watched {
                let waits = device.0.borrow_mut().status().message_waiting;
                rig.signal.observe(waits);
            }
            rig.pass(Duration::from_millis(1));
        }
        assert_eq!(codes(&emergencies), [0x8611], "watched: {is_watched}");
    }
}

/// With many devices the slots for frames are all taken at times: the thread has to get to the link for one to be free again.
#[test]
fn a_message_that_is_asked_for_again_waits_for_a_slot_and_does_not_keep_the_thread() {
    let (rig, device, handle, _) = device_with_statusword();
    // The device is quick: from now on its mailbox is read at once, without a look before.
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
    let now = rig.clock.now();
    {
        let mut state = device.0.borrow_mut();
        state.swallow = 1;
        // At the deadline of 1 s other devices' requests have all slots, for 100 ms.
        state.busy = now + Duration::from_millis(950)..now + Duration::from_millis(1050);
    }
    let error = read_statusword(&rig, &handle).unwrap_err().error;
    assert!(matches!(error, SdoError::Timeout { .. }), "{error}");
}

/// All others of the drive wait behind it: those of a recovery, and the parameters of a move.
#[test]
fn a_transfer_without_a_limit_that_was_dropped_holds_the_mailbox_no_longer_than_another() {
    let (rig, device, handle, _) = device_with_statusword();
    device.0.borrow_mut().swallow = 1;
    let patient = handle.clone().with_timeout(Duration::MAX);
    let clock = rig.clock.clone();
    rig.run(async move {
        let read = async { drop(patient.read(obj::PROFILE_VELOCITY).await) };
        let limit = async {
            let until = clock.now() + Duration::from_secs(1);
            clock.sleep_until(until).await;
        };
        smol::future::or(read, limit).await;
    });
    let clock = rig.clock.clone();
    let read = rig.run(async move {
        let read = async { Some(handle.read(obj::STATUSWORD).await) };
        let limit = async {
            // The second for a reply, and a little.
            let until = clock.now() + Duration::from_millis(1_100);
            clock.sleep_until(until).await;
            None
        };
        smol::future::or(read, limit).await
    });
    assert_eq!(read, Some(Ok(0x1637)));
}
