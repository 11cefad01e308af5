//! A write whose frame is lost, on devices that do not look at the mailbox counter; error replies that come late.

use super::*;

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
