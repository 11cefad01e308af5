//! Pitfalls 1 to 6: bit 4 and bit 12.

use servocrab::ds402::Statusword;
use servocrab::{BufferMode, SetPoint};
use servocrab::{
    Doubt, Failure,
    axis::{Completion, Delivery, WaitingFor},
};
use servocrab_sim::ds402::{AckFault, AckPolicy, Behaviour, Outcome};

use crate::common::{Link, Rig};
use crate::{BIT_4, enabled, rises};

/// Whether the move failed because bit 12 did not fall, without having been sent.
fn never_sent_for_bit_12(outcome: Option<Result<Completion, Failure>>) -> bool {
    matches!(
        outcome,
        Some(Err(Failure::Timeout {
            waiting_for: WaitingFor::AcknowledgeLow,
            delivery: Delivery::NotSent,
            ..
        }))
    )
}

/// A drive whose bit 12 stays 1 while its buffer is full, of which the library does not know that.
fn full_buffer_unknown_to_us() -> Rig {
    let mut rig = Rig::new(Behaviour::generic(), |_| {});
    rig.enable();
    rig
}

#[test]
fn pitfall_01_bit_4_low_reaches_the_wire_between_two_moves() {
    for latency in 0..4 {
        let mut rig = Rig::enabled();
        rig.latency = latency;
        let from = rig.words.len();
        let first = rig.abs(20_000, SetPoint::new());
        let second = rig.abs(-20_000, SetPoint::new());
        rig.assert_reached(second, -20_000);
        assert_eq!(rig.outcome(first), Some(Err(Failure::Superseded)));
        assert_eq!(rig.ledger().len(), 2, "inputs {latency} cycles late");
        assert_eq!(rises(&rig.words[from..], BIT_4), 2);
    }
}

#[test]
fn pitfall_01_two_moves_stay_two_whichever_frame_is_lost() {
    for lost in 0..20 {
        for link in [Link::RequestLost, Link::ReplyLost, Link::Miscounted] {
            let mut rig = Rig::enabled();
            rig.abs(20_000, SetPoint::new());
            let second = rig.abs(-20_000, SetPoint::new());
            rig.run(lost);
            rig.cycle_over(link);
            rig.assert_reached(second, -20_000);
            assert_eq!(rig.ledger().len(), 2, "frame {lost}, {link:?}");
        }
    }
}

#[test]
fn pitfall_02_bit_4_stays_high_until_a_slow_drive_acknowledges() {
    for (filter, delay) in [(0, 30), (5, 0), (20, 20)] {
        let mut rig = enabled(|drive| drive.bit_4_filter_cycles = filter);
        rig.drive.disturbances().ack_delay_cycles = delay;
        let id = rig.abs(10_000, SetPoint::new());
        rig.assert_reached(id, 10_000);
        assert_eq!(rig.ledger().len(), 1, "filter {filter}, delay {delay}");
        let high = rig.words.iter().filter(|word| **word & BIT_4 != 0).count();
        assert!(high > (filter + delay) as usize, "high for {high} frames");
    }
}

#[test]
fn pitfall_03_a_command_while_bit_12_is_high_does_not_leave_bit_4_stuck() {
    let mut rig = full_buffer_unknown_to_us();
    rig.abs(5_000, SetPoint::new());
    let queued = rig.abs(10_000, SetPoint::new().buffer_mode(BufferMode::Buffered));
    rig.wait_accepted(queued);
    rig.run(3);
    assert_eq!(rig.word() & BIT_4, 0);
    assert!(rig.statusword().contains(Statusword::SET_POINT_ACKNOWLEDGE));

    let third = rig.abs(-5_000, SetPoint::new());
    rig.wait_accepted(third);
    rig.run(3);
    assert_eq!(rig.word() & BIT_4, 0, "bit 4 is low again");
    rig.assert_reached(third, -5_000);
    assert_eq!(rig.ledger().len(), 3);
}

#[test]
fn pitfall_04_an_acknowledge_left_from_the_move_before_is_not_taken_for_a_new_one() {
    for latency in 0..4 {
        let mut rig = Rig::enabled();
        rig.latency = latency;
        let first = rig.abs(20_000, SetPoint::new());
        rig.wait_accepted(first);
        rig.drive.disturbances().deaf_to_bit_4 = true;
        let second = rig.abs(-20_000, SetPoint::new());
        let outcome = rig.finish(second);
        assert!(
            matches!(
                outcome,
                Err(Failure::Unknown {
                    doubt: Doubt::Unacknowledged,
                    ..
                })
            ),
            "inputs {latency} cycles late: {outcome:?}"
        );
        assert!(!rig.accepted(second));
    }
}

#[test]
fn pitfall_04_a_bit_12_that_is_always_1_acknowledges_nothing() {
    let mut rig = Rig::enabled();
    rig.drive.disturbances().ack = AckFault::StuckHigh;
    let id = rig.abs(10_000, SetPoint::new());
    let outcome = rig.finish(id);
    assert!(never_sent_for_bit_12(Some(outcome)), "{outcome:?}");
    assert!(!rig.accepted(id));
    assert!(rig.ledger().is_empty());
}

#[test]
fn pitfall_05_a_drive_that_idles_with_bit_12_high_gives_an_error_in_time() {
    let mut rig = enabled(|drive| drive.ack = AckPolicy::StickyAtEnable);
    assert!(rig.statusword().contains(Statusword::SET_POINT_ACKNOWLEDGE));
    let id = rig.abs(10_000, SetPoint::new());
    rig.run(520); // the deadline of an acknowledge is 500 ms
    assert!(
        never_sent_for_bit_12(rig.outcome(id)),
        "{:?}",
        rig.outcome(id)
    );
    assert_eq!(rises(&rig.words, BIT_4), 0, "nothing was sent");
    assert!(rig.ledger().is_empty());
}

#[test]
fn pitfall_06_a_full_buffer_that_holds_bit_12_high_gives_an_error_in_time() {
    let mut rig = full_buffer_unknown_to_us();
    let first = rig.abs(100_000, SetPoint::new());
    let queued = rig.abs(110_000, SetPoint::new().buffer_mode(BufferMode::Buffered));
    rig.wait_accepted(queued);
    // An absolute one would be sent without an acknowledge; a distance must have one.
    let third = rig.rel(-1_000, SetPoint::new());
    rig.run(520);
    assert!(
        never_sent_for_bit_12(rig.outcome(third)),
        "{:?}",
        rig.outcome(third)
    );
    assert_eq!(rig.ledger().len(), 2, "nothing was sent");
    assert_eq!(rig.ledger()[0].outcome, Outcome::Active);
    assert_eq!(rig.outcome(first), None, "the moves before it go on");
    assert!(rig.finish(queued).is_ok());
}
