//! Ways that once broke a law.

use servocrab::BufferMode;
use servocrab::axis::{Completion, Event};

use crate::{
    descriptions,
    world::{ACTS, Act, Ask, EVERY_KIND, Size, World},
};

/// Runs this, where the drive does what it can at once or (`false`) not, in every world.
fn laws_hold_on(way: &[(Act, bool)]) {
    let size = Size {
        commands: 2,
        deviations: 2,
        kinds: EVERY_KIND,
    };
    for description in descriptions() {
        let mut world = World::new(description, size);
        for &(act, prompt) in way {
            let number = ACTS.iter().position(|other| *other == act);
            let number = number.expect("one of all acts") as u8;

            if let Err(what) = world.step(number, prompt) {
                panic!("{description:?}: {act:?}: {world}{what}");
            }
        }
    }
}

const NOTHING: (Act, bool) = (Act::Nothing, true);

const fn ask(ask: Ask) -> (Act, bool) {
    (Act::Ask(ask), true)
}

/// Two positions away.
const MOVE: Act = Act::Move {
    goal: -2,
    buffer_mode: BufferMode::Aborting,
};

#[test]
fn a_drive_that_was_told_to_enable_is_not_down_by_what_it_showed_before() {
    laws_hold_on(&[
        NOTHING,
        ask(Ask::Enable),
        (Act::Wrong(0x21), true),
        NOTHING,
        NOTHING,
        (Act::Wrong(0x21), true),
        NOTHING,
        (MOVE, true),
        (Act::Wrong(0x23), false),
        (Act::Ask(Ask::Enable), false),
        NOTHING,
        NOTHING,
        NOTHING,
    ]);
}

#[test]
fn a_halt_that_is_over_is_no_proof_of_a_standstill() {
    let mut way = vec![NOTHING; 5];
    way.push(ask(Ask::Enable));
    way.extend([NOTHING; 8]);
    way.extend([ask(Ask::Halt), NOTHING, NOTHING, ask(Ask::Resume)]);
    way.push((MOVE, false));
    way.extend([(Act::Nothing, false); 4]);
    way.extend([(Act::Wrong(0x40), true), NOTHING, NOTHING, NOTHING]);
    laws_hold_on(&way);
}

#[test]
fn a_halt_of_a_moving_axis_ends_when_it_stands() {
    let mut way = vec![NOTHING; 5];
    way.push(ask(Ask::Enable));
    way.extend([NOTHING; 8]);
    // Its ramp takes two cycles.
    way.extend([(MOVE, true), (Act::Ask(Ask::Halt), false)]);
    way.push((Act::Nothing, false));
    way.extend([NOTHING; 8]);
    laws_hold_on(&way);
}

#[test]
fn a_reset_without_a_fault_does_not_say_that_a_moving_axis_stands() {
    let size = Size {
        commands: 2,
        deviations: 0,
        kinds: EVERY_KIND,
    };
    let mut world = World::new(descriptions()[0], size);
    let mut way = vec![NOTHING; 5];
    way.push(ask(Ask::Enable));
    way.extend([NOTHING; 8]);
    way.extend([(MOVE, true), ask(Ask::Reset)]);
    world.told = Some(Vec::new());
    for (act, prompt) in way {
        let number = ACTS.iter().position(|other| *other == act);
        let number = number.expect("one of all acts") as u8;
        world.step(number, prompt).expect("no law is broken");
    }
    let told = world.told.expect("it was asked for");
    let stands = |event: &Event| matches!(event, Event::Done(Ok(Completion::Stopped { .. })));
    assert!(!told.iter().any(|(_, event)| stands(event)), "{told:?}");
}
