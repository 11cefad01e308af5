//! A jog from its first word to its rest, cycle by cycle of 1 ms.

use alloc::vec::Vec;

use super::*;
use crate::{ds402::Controlword, profile_position::Eyes};

const ID: CommandId = CommandId(3);
const OTHER: CommandId = CommandId(4);

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

struct Scene {
    jog: Jogging,
    events: Events,
    eyes: Eyes,
    now: Duration,
    position: i32,
    delivered: bool,
}

impl Scene {
    fn new() -> Self {
        Self {
            jog: Jogging::new(),
            events: Events::new(),
            eyes: Eyes::new(),
            now: ms(10_000),
            position: 0,
            delivered: true,
        }
    }

    /// With a jog that is held, and that nothing was sent of.
    fn held() -> Self {
        let mut this = Self::new();
        let set_point = JogSetPoint::new(-50).acceleration(7).deceleration(8);
        this.jog.submit(ID, set_point, &mut this.events);
        this
    }

    /// One that the drive follows.
    fn accepted() -> Self {
        let mut this = Self::held();
        this.jog.mark_sent(&mut this.events);
        this.step();
        assert_eq!(this.reports(), [(ID, Event::Accepted)]);
        this
    }

    fn step(&mut self) {
        self.now += ms(1);
        let mut cycle = self
            .eyes
            .see(self.now, 0x0237, self.position, Controlword::empty());
        cycle.delivered = self.delivered;
        if self.jog.step(&cycle, &mut self.events) == JogStep::Seen {
            self.eyes.count_rest_anew();
        }
    }

    fn reports(&mut self) -> Vec<(CommandId, Event)> {
        core::iter::from_fn(|| self.events.pop()).collect()
    }
}

/// What it says of itself: the velocity in the outputs; whether there is motion, it is held, released, idle, a cycle may be the cheap one.
fn said(jog: &Jogging) -> (i32, [bool; 5]) {
    let flags = [
        jog.has_motion(),
        jog.is_held(),
        jog.is_released(),
        jog.is_idle(),
        jog.due() == Due::NEVER,
    ];
    (jog.velocity(), flags)
}

#[test]
fn a_jog_says_what_it_is_from_its_first_word_to_its_rest() {
    let mut scene = Scene::new();
    assert_eq!(said(&scene.jog), (0, [false, false, false, true, true]));
    assert_eq!(scene.jog.id(), None);

    scene = Scene::held();
    assert_eq!(said(&scene.jog), (-50, [false, true, false, false, false]));
    assert_eq!(scene.jog.id(), Some(ID));
    let ramps = scene.jog.ramps();
    assert_eq!((ramps.acceleration, ramps.deceleration), (Some(7), Some(8)));
    assert_eq!((ramps.velocity, ramps.end_velocity), (None, None));
    scene.step();
    assert_eq!(scene.reports(), [], "nothing was sent");
    scene.jog.mark_sent(&mut scene.events);
    assert_eq!(said(&scene.jog), (-50, [true, true, false, false, false]));
    scene.delivered = false;
    scene.step();
    assert_eq!(scene.reports(), [], "nothing came to the drive");
    scene.delivered = true;
    scene.step();
    scene.step();
    assert_eq!(scene.reports(), [(ID, Event::Accepted)], "once");
    assert_eq!(said(&scene.jog), (-50, [true, true, false, false, true]));

    assert!(!scene.jog.set(OTHER, 60) && scene.jog.set(ID, 60));
    assert_eq!(scene.jog.velocity(), 60);
    assert!(!scene.jog.release(OTHER, Timer::OVER, false));
    assert!(scene.jog.release(ID, Timer::new(ms(5_000)), false));
    assert_eq!(said(&scene.jog), (0, [true, false, true, false, false]));
    assert_eq!(scene.jog.id(), Some(ID));
    assert!(!scene.jog.set(ID, 60) && !scene.jog.release(ID, Timer::OVER, false));
}

#[test]
fn a_jog_is_withdrawn_before_it_is_sent_and_not_after() {
    let delivery = Delivery::NotSent;
    let failure = Failure::Halted { delivery };
    let mut scene = Scene::held();
    assert!(!scene.jog.withdraw(OTHER, failure, &mut scene.events));
    assert!(scene.jog.is_held());
    assert!(scene.jog.withdraw(ID, failure, &mut scene.events));
    assert_eq!(scene.reports(), [(ID, Event::Done(Err(failure)))]);
    assert!(scene.jog.is_idle());
    let mut sent = Scene::held();
    sent.jog.mark_sent(&mut sent.events);
    assert!(!sent.jog.withdraw(ID, failure, &mut sent.events));
    assert!(sent.jog.is_held());
}

#[test]
fn what_ends_a_jog_says_how_far_it_came() {
    let halted = |delivery| Failure::Halted { delivery };
    let mut sent = Scene::held();
    sent.jog.mark_sent(&mut sent.events);
    let mut released = Scene::accepted();
    released.jog.release(ID, Timer::new(ms(99_999)), false);
    for (mut scene, delivery) in [
        (Scene::held(), Delivery::NotSent),
        (sent, Delivery::Unknown),
        (Scene::accepted(), Delivery::Accepted),
        (released, Delivery::Accepted),
    ] {
        scene.jog.end(halted(Delivery::Unknown), &mut scene.events);
        assert_eq!(scene.reports(), [(ID, Event::Done(Err(halted(delivery))))]);
        assert!(scene.jog.is_idle());
        scene.jog.end(halted(Delivery::Unknown), &mut scene.events);
        assert_eq!(scene.reports(), [], "once");
    }
}

#[test]
fn a_jog_takes_over_from_one_that_comes_to_rest_and_not_from_one_that_is_held() {
    let mut scene = Scene::accepted();
    scene.jog.submit(OTHER, 5.into(), &mut scene.events);
    let busy = Event::Done(Err(Failure::Busy));
    assert_eq!(scene.reports(), [(OTHER, busy)]);
    assert_eq!((scene.jog.id(), scene.jog.velocity()), (Some(ID), -50));
    scene.jog.release(ID, Timer::new(ms(99_999)), false);
    scene.jog.submit(OTHER, 5.into(), &mut scene.events);
    assert_eq!(scene.reports(), [], "the next one was not sent");
    scene.jog.mark_sent(&mut scene.events);
    let superseded = Event::Done(Err(Failure::Superseded));
    assert_eq!(scene.reports(), [(ID, superseded)]);
    assert_eq!((scene.jog.id(), scene.jog.velocity()), (Some(OTHER), 5));
}

/// The drive takes the 0 in within two of its cycles, and the axis has to stand for 100 ms after that.
#[test]
fn a_released_jog_is_over_when_the_axis_has_stood_since_the_drive_took_the_zero_in() {
    for (by_itself, result) in [
        (
            false,
            Ok(Completion::Stopped {
                state: State::OperationEnabled,
            }),
        ),
        (true, Err(Failure::NotHeld)),
    ] {
        let mut scene = Scene::accepted();
        for _ in 0..200 {
            scene.step();
        }
        scene.jog.release(ID, Timer::new(ms(5_000)), by_itself);
        scene.step();
        scene.step();
        assert_eq!(scene.reports(), [], "the 0 was not sent");
        scene.jog.mark_sent(&mut scene.events);
        scene.delivered = false;
        scene.step();
        scene.delivered = true;
        scene.step();
        for cycle in 0..103 {
            assert_eq!(scene.reports(), [], "{cycle}");
            scene.step();
        }
        assert_eq!(scene.reports(), [(ID, Event::Done(result))]);
        assert!(scene.jog.is_idle());
    }
}

#[test]
fn a_released_jog_whose_axis_does_not_come_to_rest_ends_in_time() {
    let mut scene = Scene::accepted();
    scene.jog.release(ID, Timer::new(ms(50)), false);
    scene.jog.mark_sent(&mut scene.events);
    for _ in 0..49 {
        scene.position += 100;
        scene.step();
    }
    assert_eq!(scene.reports(), []);
    scene.position += 100;
    scene.step();
    let reports = scene.reports();
    assert!(
        matches!(
            reports[..],
            [(
                ID,
                Event::Done(Err(Failure::Timeout {
                    delivery: Delivery::Accepted,
                    ..
                }))
            )]
        ),
        "{reports:?}"
    );
    assert!(scene.jog.is_idle());
}

#[test]
fn a_holder_is_silent_after_its_dead_man_time_and_not_at_it() {
    let mut jog = Jogging::new();
    let set_point = JogSetPoint::new(5).dead_man(ms(20));
    let mut events = Events::new();
    jog.submit(ID, set_point, &mut events);
    assert!(jog.has_dead_man());
    assert!(!jog.is_silent(ms(100), ID, 1), "its first word");
    assert!(!jog.is_silent(ms(120), ID, 1));
    assert!(jog.is_silent(ms(120) + Duration::from_nanos(1), ID, 1));
    assert!(!jog.is_silent(ms(130), ID, 2), "another word");
    assert!(!jog.is_silent(ms(150), ID, 2));
    assert!(jog.is_silent(ms(151), ID, 2));
    assert!(!jog.is_silent(ms(999), OTHER, 2));
    jog.release(ID, Timer::new(ms(5_000)), true);
    assert!(!jog.has_dead_man() && !jog.is_silent(ms(999), ID, 2));
    assert!(!Scene::held().jog.has_dead_man());
    assert!(!Scene::held().jog.is_silent(ms(99_999), ID, 0));
}
