//! The procedure as a dialogue: what the drive shows, and what bit 4 and the reports are then.

use alloc::vec::Vec;
use core::time::Duration;

use super::{HomingCommand, HomingVerdict, Procedure};
use crate::HomingMethod;
use crate::{
    Failure,
    ds402::{Controlword, ModeBits},
    profile_position::{CommandId, Completion, Delivery, Event, Events, Eyes, WaitingFor},
    timer::Due,
};

const ID: CommandId = CommandId(7);
/// Operation enabled.
const ENABLED: u16 = 0x0637 & !0x0400;
/// Bits 13, 12, 10 as the table has them.
const NOT_STARTED: u16 = 0x0400;
const IN_PROGRESS: u16 = 0;
const ATTAINED_MOVING: u16 = 0x1000;
const DONE: u16 = 0x1400;
const ERROR_MOVING: u16 = 0x2000;
const ERROR: u16 = 0x2400;

struct Dialogue {
    procedure: Procedure,
    events: Events,
    eyes: Eyes,
    now: Duration,
    velocity: i32,
    position: i32,
    delivered: bool,
    halted: bool,
    /// Whether frames go out.
    sends: bool,
    sent: Controlword,
    /// What is sent besides: bit 4, as another mode has left it.
    besides: Controlword,
    verdict: HomingVerdict,
}

impl Dialogue {
    /// An axis at this position.
    fn at(position: i32) -> Self {
        Self {
            procedure: Procedure::new(),
            events: Events::new(),
            eyes: Eyes::new(),
            now: Duration::ZERO,
            velocity: 0,
            position,
            delivered: true,
            halted: false,
            sends: true,
            sent: Controlword::empty(),
            besides: Controlword::empty(),
            verdict: HomingVerdict::GoOn,
        }
    }

    /// Asks for a homing with home at -500, on a drive that shows these bits, up to its bit 4.
    fn submit(&mut self, until: Option<Duration>, method: HomingMethod, bits: u16) {
        self.procedure.submit(
            ID,
            HomingCommand {
                method,
                offset: Some(-500),
                until,
            },
            &mut self.events,
        );
        // Low, seen low, raised, and sent with the cycle after.
        for _ in 0..3 {
            assert_eq!(self.procedure.bits(), ModeBits::NONE);
            self.shows(bits);
        }
        assert_eq!(self.procedure.bits(), ModeBits::HOMING_START);
    }

    /// A homing by this method that waits for its start, on a drive that shows these bits.
    fn begin(method: HomingMethod, bits: u16) -> Self {
        Self::begin_within(Duration::from_secs(1), method, bits)
    }

    /// The same, with another deadline for standstill.
    fn begin_within(standstill: Duration, method: HomingMethod, bits: u16) -> Self {
        Self::begin_until(None, standstill, method, bits)
    }

    /// The same, with a limit of its own time.
    fn begin_until(
        until: Option<Duration>,
        standstill: Duration,
        method: HomingMethod,
        bits: u16,
    ) -> Self {
        let mut this = Self::at(500);
        this.eyes.standstill = standstill;
        this.submit(until, method, bits);
        this
    }

    /// One cycle of 1 ms, in which the drive shows these bits.
    fn shows(&mut self, bits: u16) -> &mut Self {
        self.now += Duration::from_millis(1);
        self.position += self.velocity;
        self.sent = self.procedure.bits().word() | self.besides;
        if self.sends {
            self.procedure.mark_sent();
        }
        let mut cycle = self
            .eyes
            .see(self.now, ENABLED | bits, self.position, self.sent);
        cycle.delivered = self.delivered;
        cycle.halted = self.halted;
        self.verdict = self.procedure.step(&cycle, &mut self.events);
        self
    }

    fn shows_for(&mut self, cycles: u32, bits: u16) -> &mut Self {
        for _ in 0..cycles {
            self.shows(bits);
        }
        self
    }

    fn is_high(&self) -> bool {
        self.procedure.bits() == ModeBits::HOMING_START
    }

    fn reports(&mut self) -> Vec<Event> {
        core::iter::from_fn(|| self.events.pop())
            .map(|(id, event)| {
                assert_eq!(id, ID);
                event
            })
            .collect()
    }

    /// That its only report is the end of its time, of a homing that the drive has accepted.
    #[track_caller]
    fn ends_by_its_time(&mut self) {
        let reports = self.reports();
        assert!(
            matches!(
                reports[..],
                [Event::Done(Err(Failure::Timeout {
                    waiting_for: WaitingFor::HomingEnd,
                    delivery: Delivery::Accepted,
                    ..
                }))]
            ),
            "{reports:?}"
        );
    }
}

fn homed() -> Event {
    Event::Done(Ok(Completion::Homed { position: 500 }))
}

#[test]
fn bit_4_stays_high_from_the_start_until_the_homing_is_attained_and_at_rest() {
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    homing.shows(NOT_STARTED);
    assert!(homing.reports().is_empty());
    homing.velocity = -50;
    homing.shows_for(1000, IN_PROGRESS);
    assert_eq!(homing.reports(), [Event::Accepted]);
    homing.shows(ATTAINED_MOVING);
    assert!(homing.is_high());
    homing.velocity = 0;
    homing.position = 500;
    for _ in 0..120 {
        if homing.verdict != HomingVerdict::Attained {
            homing.shows(DONE);
        }
    }
    assert_eq!(homing.verdict, HomingVerdict::Attained);
    assert!(!homing.is_high());
    assert_eq!(homing.reports(), [homed()]);
    assert!(homing.procedure.is_idle());
}

#[test]
fn progress_that_the_drive_shows_before_it_has_seen_bit_4_is_not_that_of_this_homing() {
    // It never begins, whether bit 10 comes back or not.
    for then in [IN_PROGRESS, NOT_STARTED] {
        let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, IN_PROGRESS);
        homing.shows_for(3, IN_PROGRESS);
        for cycle in 3..2_000 {
            assert!(homing.reports().is_empty(), "{cycle}");
            // Its encoder dithers.
            homing.position = 500 + cycle % 3 - 1;
            homing.shows(then);
        }
        let reports = homing.reports();
        assert!(
            matches!(
                reports[..],
                [Event::Done(Err(Failure::Timeout {
                    waiting_for: WaitingFor::HomingStart,
                    ..
                }))]
            ),
            "{reports:?}"
        );
    }
    // One that moves has begun.
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, IN_PROGRESS);
    homing.shows_for(100, IN_PROGRESS);
    assert!(homing.reports().is_empty());
    homing.position -= 11;
    homing.shows(IN_PROGRESS);
    assert_eq!(homing.reports(), [Event::Accepted]);
    homing.position = 500;
    homing.shows_for(110, DONE);
    assert_eq!(homing.reports(), [homed()]);
}

#[test]
fn what_moves_or_rises_before_the_drive_can_have_seen_bit_4_is_not_of_this_homing() {
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, IN_PROGRESS);
    homing.delivered = false;
    homing.position -= 20;
    homing.shows_for(100, IN_PROGRESS);
    assert!(homing.reports().is_empty());
    homing.position = 500;
    homing.shows_for(100, DONE);
    assert!(homing.reports().is_empty());
    homing.delivered = true;
    homing.shows_for(4, DONE);
    assert_eq!(homing.reports(), [Event::Accepted, homed()]);
}

#[test]
fn a_stall_between_two_samples_is_no_proof_that_a_homing_is_done() {
    // The axis runs on under the drive's word.
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    homing.velocity = -50;
    homing.shows_for(10, IN_PROGRESS).shows(DONE);
    homing.now += Duration::from_millis(500);
    homing.shows_for(95, DONE);
    assert_eq!(homing.reports(), [Event::Accepted]);
    homing.shows_for(10, DONE);
    let reports = homing.reports();
    let done = |event: &Event| matches!(event, Event::Done(Ok(Completion::Homed { .. })));
    assert!(
        matches!(&reports[..], [event] if done(event)),
        "{reports:?}"
    );
    // Attained without bit 10, and at rest.
    let within = Duration::from_secs(10);
    let mut homing = Dialogue::begin_within(within, HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    homing
        .shows_for(10, IN_PROGRESS)
        .shows_for(200, ATTAINED_MOVING);
    homing.now += Duration::from_secs(3);
    homing.shows_for(10, ATTAINED_MOVING);
    assert_eq!(homing.reports(), [Event::Accepted]);
    homing.shows_for(2_000, ATTAINED_MOVING);
    assert_eq!(homing.reports(), [homed()]);
}

#[test]
fn a_stall_between_two_samples_is_no_proof_that_an_old_result_is_of_this_homing() {
    let mut homing = Dialogue::begin(HomingMethod::CURRENT_POSITION, DONE);
    homing.shows(DONE);
    homing.now += Duration::from_millis(300);
    homing.shows_for(70, DONE);
    assert_eq!(homing.reports(), []);
    homing.shows_for(10, DONE);
    assert_eq!(homing.reports(), [Event::Accepted, homed()]);
}

#[test]
fn a_drive_that_shows_progress_all_the_time_may_finish_before_the_axis_is_seen_to_move() {
    for method in [HomingMethod::NEGATIVE_LIMIT, HomingMethod::CURRENT_POSITION] {
        let mut homing = Dialogue::begin(method, IN_PROGRESS);
        homing.shows_for(100, IN_PROGRESS).shows_for(3, DONE);
        assert_eq!(homing.reports(), [Event::Accepted, homed()], "{method:?}");
    }
}

#[test]
fn a_homing_that_is_attained_without_bit_10_is_done_when_the_axis_has_rested() {
    for method in [HomingMethod::NEGATIVE_LIMIT, HomingMethod::CURRENT_POSITION] {
        let standstill = Duration::from_secs(10);
        let mut homing = Dialogue::begin_within(standstill, method, NOT_STARTED);
        homing.velocity = -50;
        homing.shows_for(100, IN_PROGRESS);
        // Still on its way.
        homing.shows_for(500, ATTAINED_MOVING);
        assert_eq!(homing.reports(), [Event::Accepted]);
        homing.velocity = 0;
        homing.position = 500;
        homing.shows_for(400, ATTAINED_MOVING);
        assert!(homing.reports().is_empty() && homing.is_high());
        homing.shows_for(1_710, ATTAINED_MOVING);
        assert_eq!(homing.reports(), [homed()]);
        assert!(!homing.is_high());
    }
}

#[test]
fn a_homing_that_the_drive_is_no_longer_at_work_on_ends_in_time() {
    // Attained, and never at rest; interrupted, at rest; attained, with a bit 10 that comes and goes.
    for (bits, restless) in [
        ([ATTAINED_MOVING, ATTAINED_MOVING], true),
        ([NOT_STARTED, NOT_STARTED], false),
        ([ATTAINED_MOVING, DONE], true),
    ] {
        let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
        homing.shows_for(100, IN_PROGRESS);
        assert_eq!(homing.reports(), [Event::Accepted]);
        for cycle in 0..1_000 {
            assert!(homing.reports().is_empty(), "{cycle}");
            if restless {
                homing.position = 500 + cycle % 2 * 40;
            }
            homing.shows(bits[(cycle % 2) as usize]);
        }
        homing.ends_by_its_time();
        assert_eq!(homing.verdict, HomingVerdict::EndIt);
        assert!(homing.is_high(), "until it is stopped");
    }
}

#[test]
fn what_an_earlier_homing_has_left_in_bit_12_is_not_taken_for_this_one() {
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, DONE);
    // The drive takes its time.
    homing.shows_for(300, DONE);
    assert!(homing.is_high() && homing.reports().is_empty());
    homing.shows_for(50, IN_PROGRESS).shows_for(3, DONE);
    assert_eq!(homing.reports(), [Event::Accepted, homed()]);
}

#[test]
fn a_drive_that_shows_nothing_but_an_old_result_has_not_homed() {
    for method in [HomingMethod::NEGATIVE_LIMIT, HomingMethod::INDEX_POSITIVE] {
        let mut homing = Dialogue::begin(method, DONE);
        homing.shows_for(502, DONE);
        let reports = homing.reports();
        assert!(
            matches!(
                reports[..],
                [Event::Done(Err(Failure::Timeout {
                    waiting_for: WaitingFor::HomingStart,
                    delivery: Delivery::Unknown,
                    ..
                }))]
            ),
            "{reports:?}"
        );
        assert!(!homing.is_high());
        assert!(homing.procedure.is_unknown() && homing.procedure.has_motion());
        homing.procedure.lower();
        assert!(homing.procedure.is_idle());
    }
}

#[test]
fn an_old_error_is_this_ones_only_when_the_drive_shows_it_anew_or_shows_nothing_else() {
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, ERROR);
    homing.shows_for(100, ERROR);
    assert!(homing.is_high() && homing.reports().is_empty());
    homing.shows_for(20, IN_PROGRESS).shows_for(3, DONE);
    assert_eq!(homing.reports(), [Event::Accepted, homed()]);

    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, ERROR);
    homing.shows_for(504, ERROR);
    let error = Failure::HomingError { moving: false };
    assert_eq!(homing.reports(), [Event::Done(Err(error))]);
    assert!(!homing.procedure.has_motion());
}

#[test]
fn one_wrong_word_is_neither_an_error_nor_the_end_nor_the_beginning_of_a_homing() {
    // An error at rest, of an axis that moves.
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    homing.velocity = -50;
    homing
        .shows_for(10, IN_PROGRESS)
        .shows(ERROR)
        .shows_for(50, IN_PROGRESS);
    assert_eq!(homing.reports(), [Event::Accepted]);
    // The end, while the axis stands on its way: it turns round.
    homing.velocity = 0;
    homing
        .shows_for(200, IN_PROGRESS)
        .shows(DONE)
        .shows_for(50, IN_PROGRESS);
    assert!(homing.reports().is_empty() && homing.is_high());
    homing.shows_for(3, DONE);
    let position = homing.position;
    assert_eq!(
        homing.reports(),
        [Event::Done(Ok(Completion::Homed { position }))]
    );

    // The beginning: the drive takes its time, and shows what an earlier homing has left.
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, DONE);
    homing
        .shows_for(5, DONE)
        .shows(IN_PROGRESS)
        .shows_for(300, DONE);
    assert!(homing.is_high() && homing.reports().is_empty());
    homing.shows_for(50, IN_PROGRESS).shows_for(3, DONE);
    assert_eq!(homing.reports(), [Event::Accepted, homed()]);
}

#[test]
fn a_homing_that_was_over_within_one_word_is_done_in_the_time_of_a_beginning() {
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, DONE);
    homing.shows_for(5, DONE).shows(IN_PROGRESS);
    homing.shows_for(485, DONE);
    assert!(homing.reports().is_empty());
    homing.shows_for(15, DONE);
    assert_eq!(homing.reports(), [Event::Accepted, homed()]);
}

#[test]
fn an_error_is_reported_at_rest_and_an_axis_that_does_not_come_to_rest_is_stopped() {
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    homing.velocity = -50;
    homing
        .shows_for(10, IN_PROGRESS)
        .shows_for(30, ERROR_MOVING);
    assert_eq!(homing.reports(), [Event::Accepted]);
    homing.velocity = 0;
    homing.shows(ERROR);
    assert_eq!(homing.reports(), []);
    homing.shows_for(110, ERROR);
    let error = |moving| Event::Done(Err(Failure::HomingError { moving }));
    assert_eq!(homing.reports(), [error(false)]);
    assert!(!homing.is_high());
    assert_eq!(homing.verdict, HomingVerdict::GoOn);

    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    homing.velocity = -50;
    homing
        .shows_for(10, IN_PROGRESS)
        .shows_for(990, ERROR_MOVING);
    for _ in 0..20 {
        if homing.verdict == HomingVerdict::GoOn {
            homing.shows(ERROR_MOVING);
        }
    }
    assert_eq!(homing.reports(), [Event::Accepted, error(true)]);
    assert_eq!(homing.verdict, HomingVerdict::StopIt);
    assert!(homing.is_high(), "until the quick stop is over");
}

#[test]
fn a_homing_without_motion_is_attained_by_the_edge_of_bit_12_though_progress_was_never_seen() {
    let mut homing = Dialogue::begin(HomingMethod::CURRENT_POSITION, NOT_STARTED);
    homing.shows(NOT_STARTED).shows_for(110, DONE);
    assert_eq!(homing.reports(), [Event::Accepted, homed()]);
    // By a method that moves, the same is not enough.
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    homing.shows(NOT_STARTED).shows_for(400, DONE);
    assert_eq!(homing.reports(), [Event::Accepted]);
}

#[test]
fn a_homing_without_motion_over_an_old_result_is_attained_when_it_has_stood_long_enough() {
    let mut homing = Dialogue::begin(HomingMethod::CURRENT_POSITION, DONE);
    homing.shows_for(100, DONE);
    assert!(homing.reports().is_empty());
    homing.shows(DONE);
    assert_eq!(homing.reports(), [Event::Accepted, homed()]);

    // Not where it would read something else at home.
    let mut homing = Dialogue::begin(HomingMethod::CURRENT_POSITION, DONE);
    homing.position = 511;
    homing.shows_for(400, DONE);
    assert!(homing.reports().is_empty());

    // It counts from when bit 4 is known to have been delivered.
    let mut homing = Dialogue::begin(HomingMethod::CURRENT_POSITION, DONE);
    homing.delivered = false;
    homing.shows_for(200, DONE);
    homing.delivered = true;
    homing.shows_for(100, DONE);
    assert!(homing.reports().is_empty());
    homing.shows(DONE);
    assert_eq!(homing.reports(), [Event::Accepted, homed()]);
}

#[test]
fn bit_4_rises_only_after_a_low_that_was_delivered_in_this_mode_for_two_cycles_of_the_drive() {
    let mut homing = Dialogue {
        delivered: false,
        ..Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED)
    };
    homing.procedure.lower();
    homing.procedure.submit(
        ID,
        HomingCommand {
            method: HomingMethod::NEGATIVE_LIMIT,
            offset: None,
            until: None,
        },
        &mut homing.events,
    );
    homing.shows_for(20, NOT_STARTED);
    assert!(!homing.is_high());
    homing.delivered = true;
    homing.shows_for(2, NOT_STARTED);
    // Another mode in between: it counts anew.
    homing.procedure.outside();
    homing.shows_for(2, NOT_STARTED);
    assert!(!homing.is_high());
    homing.shows(NOT_STARTED);
    assert!(homing.is_high());
}

#[test]
fn a_halt_ends_it_at_standstill_with_bit_4_low_and_only_leaving_operation_clears_it() {
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    homing.velocity = -50;
    homing.shows_for(10, IN_PROGRESS);
    homing.halted = true;
    homing.shows_for(10, IN_PROGRESS);
    assert!(homing.is_high());
    homing.shows(NOT_STARTED);
    homing.procedure.halted(&mut homing.events);
    assert!(!homing.is_high());
    assert_eq!(
        homing.reports(),
        [
            Event::Accepted,
            Event::Done(Err(Failure::Halted {
                delivery: Delivery::Accepted
            }))
        ]
    );
    assert!(homing.procedure.has_motion());
    homing.procedure.lower();
    assert!(!homing.procedure.has_motion());
}

#[test]
fn the_time_of_a_halted_one_that_does_not_come_to_rest_goes_on() {
    let until = Duration::from_millis(200);
    let method = HomingMethod::NEGATIVE_LIMIT;
    let mut homing =
        Dialogue::begin_until(Some(until), Duration::from_secs(1), method, NOT_STARTED);
    homing.velocity = -50;
    homing.shows_for(10, IN_PROGRESS);
    homing.halted = true;
    while homing.now + Duration::from_millis(1) < until {
        homing.shows(IN_PROGRESS);
        assert_eq!(homing.verdict, HomingVerdict::GoOn);
    }
    assert_eq!(homing.reports(), [Event::Accepted]);
    homing.shows(IN_PROGRESS);
    assert_eq!(homing.verdict, HomingVerdict::EndIt);
    homing.ends_by_its_time();
    assert!(homing.is_high(), "the stop ends it");
}

#[test]
fn what_ends_it_says_how_far_it_came_and_leaves_bit_4_to_the_stop() {
    let bus_lost = |delivery| Failure::BusLost { delivery };
    let lost = bus_lost(Delivery::NotSent);
    let ended = |delivery| Event::Done(Err(bus_lost(delivery)));
    let mut unsent = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    unsent.procedure.fail(lost, &mut unsent.events);
    assert_eq!(unsent.reports(), [ended(Delivery::NotSent)]);
    assert!(!unsent.is_high());

    let mut sent = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    sent.shows(NOT_STARTED);
    sent.procedure.fail(lost, &mut sent.events);
    assert_eq!(sent.reports(), [ended(Delivery::Unknown)]);
    assert!(sent.is_high());

    let mut begun = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    begun.shows_for(3, IN_PROGRESS);
    begun.procedure.fail(lost, &mut begun.events);
    assert_eq!(
        begun.reports(),
        [Event::Accepted, ended(Delivery::Accepted)]
    );
    assert!(begun.is_high());
    begun.procedure.lower();
    assert!(!begun.is_high());
}

fn by(method: HomingMethod) -> HomingCommand {
    HomingCommand {
        method,
        offset: None,
        until: None,
    }
}

#[test]
fn a_homing_that_nobody_asks_for_needs_no_cycle_once_the_low_of_bit_4_is_delivered() {
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    assert_eq!(homing.procedure.due(true), Due::NEXT, "it is on its way");
    homing.procedure.lower();
    assert_eq!(homing.procedure.due(false), Due::NEVER, "in another mode");
    assert_eq!(homing.procedure.due(true), Due::NEXT);
    homing.shows(NOT_STARTED);
    assert_eq!(homing.procedure.due(true), Due::NEVER);
    let command = by(HomingMethod::NEGATIVE_LIMIT);
    homing.procedure.submit(ID, command, &mut homing.events);
    assert_eq!(homing.procedure.due(true), Due::NEXT);
}

#[cfg(feature = "std")]
#[test]
fn a_homing_is_under_way_from_its_bit_4_on_to_its_end() {
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    assert!(!homing.procedure.is_under_way(ID) && !homing.procedure.has_motion());
    homing.shows(NOT_STARTED);
    assert!(homing.procedure.is_under_way(ID) && homing.procedure.has_motion());
    assert!(!homing.procedure.is_under_way(CommandId(8)));
    homing.shows_for(50, IN_PROGRESS).shows_for(110, DONE);
    assert_eq!(homing.reports(), [Event::Accepted, homed()]);
    assert!(!homing.procedure.is_under_way(ID) && !homing.procedure.has_motion());
}

#[test]
fn one_homing_waits_at_a_time() {
    let mut procedure = Procedure::new();
    let mut events = Events::new();
    let command = by(HomingMethod::NEGATIVE_LIMIT);
    procedure.submit(ID, command, &mut events);
    assert!(events.pop().is_none() && !procedure.is_idle());
    procedure.submit(CommandId(8), command, &mut events);
    let busy = Event::Done(Err(Failure::Busy));
    assert_eq!(events.pop(), Some((CommandId(8), busy)));
    // The first one waits on.
    let failure = Failure::NeedsStop;
    assert!(!procedure.withdraw(CommandId(8), failure, &mut events));
    assert!(procedure.withdraw(ID, failure, &mut events));
    assert_eq!(events.pop(), Some((ID, Event::Done(Err(failure)))));
    assert!(procedure.is_idle() && events.pop().is_none());
    assert!(!procedure.withdraw(ID, failure, &mut events));
}

#[test]
fn a_homing_is_withdrawn_until_its_bit_4_is_sent() {
    let failure = Failure::NeedsStop;
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    assert!(homing.procedure.withdraw(ID, failure, &mut homing.events));
    assert_eq!(homing.reports(), [Event::Done(Err(failure))]);
    assert!(!homing.is_high());
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    assert!(homing.procedure.mark_sent(), "it has begun with this frame");
    assert!(!homing.procedure.mark_sent());
    assert!(!homing.procedure.withdraw(ID, failure, &mut homing.events));
    homing
        .procedure
        .withdraw_unsent(failure, &mut homing.events);
    assert!(homing.is_high() && homing.reports().is_empty());
}

/// In other modes the same bit is that of a set-point.
#[test]
fn bit_4_of_another_mode_is_no_low() {
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    homing.procedure.lower();
    homing.besides = Controlword::HOMING_START;
    let command = by(HomingMethod::NEGATIVE_LIMIT);
    homing.procedure.submit(ID, command, &mut homing.events);
    homing.shows_for(20, NOT_STARTED);
    assert!(!homing.is_high());
    homing.besides = Controlword::empty();
    homing.shows_for(2, NOT_STARTED);
    assert!(!homing.is_high());
    homing.shows(NOT_STARTED);
    assert!(homing.is_high());
}

#[test]
fn a_homing_that_could_not_be_sent_in_its_time_was_not_sent() {
    let until = Duration::from_millis(200);
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    homing.procedure.lower();
    homing.delivered = false;
    let command = HomingCommand {
        until: Some(until),
        ..by(HomingMethod::NEGATIVE_LIMIT)
    };
    homing.procedure.submit(ID, command, &mut homing.events);
    while homing.now + Duration::from_millis(1) < until {
        homing.shows(NOT_STARTED);
    }
    assert!(homing.reports().is_empty());
    homing.shows(NOT_STARTED);
    let reports = homing.reports();
    assert!(
        matches!(
            reports[..],
            [Event::Done(Err(Failure::Timeout {
                waiting_for: WaitingFor::HomingEnd,
                delivery: Delivery::NotSent,
                ..
            }))]
        ),
        "{reports:?}"
    );
    assert!(homing.procedure.is_idle());
}

#[test]
fn an_axis_that_is_halted_or_unheard_does_not_begin_a_homing() {
    for halted in [true, false] {
        let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
        homing.procedure.lower();
        homing.shows_for(20, NOT_STARTED);
        (homing.halted, homing.delivered) = (halted, halted);
        let command = by(HomingMethod::NEGATIVE_LIMIT);
        homing.procedure.submit(ID, command, &mut homing.events);
        homing.shows_for(20, NOT_STARTED);
        assert!(!homing.is_high());
        (homing.halted, homing.delivered) = (false, true);
        homing.shows(NOT_STARTED);
        assert!(homing.is_high());
    }
}

#[test]
fn the_fall_of_an_old_result_is_the_beginning_of_this_homing() {
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, DONE);
    homing.shows_for(5, DONE);
    assert!(homing.reports().is_empty());
    homing.shows(NOT_STARTED);
    assert!(homing.reports().is_empty());
    homing.shows_for(2, NOT_STARTED);
    assert_eq!(homing.reports(), [Event::Accepted]);
}

#[test]
fn an_axis_has_left_once_it_is_further_away_than_its_window() {
    for (away, begun) in [
        (10, false),
        (11, true),
        (12, true),
        (-10, false),
        (-11, true),
    ] {
        let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, IN_PROGRESS);
        homing.shows_for(10, IN_PROGRESS);
        homing.position += away;
        homing.shows(IN_PROGRESS);
        assert_eq!(homing.reports().len(), usize::from(begun), "{away}");
    }
}

/// An axis that is never quiet: the drive's word counts after the settle time.
#[test]
fn a_restless_axis_is_homed_when_all_three_bits_have_said_so_for_the_settle_time() {
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    homing.shows_for(50, IN_PROGRESS);
    assert_eq!(homing.reports(), [Event::Accepted]);
    for cycle in 0..=102 {
        assert!(homing.reports().is_empty(), "{cycle}");
        homing.position = 540 - cycle % 2 * 40;
        homing.shows(DONE);
    }
    let position = 540;
    let homed = Completion::Homed { position };
    assert_eq!(homing.reports(), [Event::Done(Ok(homed))]);
    assert_eq!(homing.verdict, HomingVerdict::Attained);
}

#[test]
fn a_bit_4_that_was_not_sent_is_not_answered() {
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, NOT_STARTED);
    homing.sends = false;
    homing.shows_for(600, IN_PROGRESS);
    assert!(homing.is_high() && homing.reports().is_empty());
}

/// Bit 12 without bit 10 counts once the axis has rested with it for the time to begin: neither moves with it, nor rested before it.
#[test]
fn an_axis_has_to_rest_with_bit_12_where_bit_10_does_not_come() {
    let begin = || {
        let standstill = Duration::from_secs(10);
        let method = HomingMethod::NEGATIVE_LIMIT;
        Dialogue::begin_within(standstill, method, NOT_STARTED)
    };
    let mut moves = begin();
    moves.velocity = -50;
    moves
        .shows_for(50, IN_PROGRESS)
        .shows_for(2_500, ATTAINED_MOVING);
    assert_eq!(moves.reports(), [Event::Accepted]);
    let mut rests = begin();
    rests
        .shows_for(2_500, IN_PROGRESS)
        .shows_for(2_002, ATTAINED_MOVING);
    assert_eq!(rests.reports(), [Event::Accepted]);
    rests.shows(ATTAINED_MOVING);
    assert_eq!(rests.reports(), [homed()]);
}

#[test]
fn one_word_without_bit_12_is_no_edge_of_a_homing_without_motion() {
    let mut homing = Dialogue::begin(HomingMethod::CURRENT_POSITION, DONE);
    // It reads something else than at home, and takes its time.
    homing.position = 9_000;
    homing
        .shows_for(3, DONE)
        .shows(NOT_STARTED)
        .shows_for(30, DONE);
    assert!(homing.is_high(), "{:?}", homing.reports());
}

#[test]
fn one_word_without_an_old_error_is_no_new_error() {
    let mut homing = Dialogue::begin(HomingMethod::NEGATIVE_LIMIT, ERROR);
    homing
        .shows_for(3, ERROR)
        .shows(NOT_STARTED)
        .shows_for(30, ERROR);
    assert!(homing.is_high(), "{:?}", homing.reports());
    homing.shows_for(80, IN_PROGRESS).shows_for(3, DONE);
    assert_eq!(homing.reports(), [Event::Accepted, homed()]);
}

/// A word without bit 12 may be wrong. That the axis has left its place is none, also once it is back there.
#[test]
fn an_axis_that_has_left_its_place_has_left_it_for_good() {
    // Where it does not read home.
    let place = 520;
    let after = |away: i32, back: i32| {
        let mut homing = Dialogue::at(place);
        homing.submit(None, HomingMethod::NEGATIVE_LIMIT, DONE);
        homing.shows_for(3, DONE).shows(NOT_STARTED);
        homing.position = away;
        homing.shows_for(20, ATTAINED_MOVING);
        homing.position = back;
        homing.shows_for(600, DONE);
        homing.reports()
    };
    let homed = |position| Event::Done(Ok(Completion::Homed { position }));
    assert_eq!(after(place, place), []);
    assert_eq!(after(700, 700), [Event::Accepted, homed(700)]);
    assert_eq!(after(700, place), [Event::Accepted, homed(place)]);
}
