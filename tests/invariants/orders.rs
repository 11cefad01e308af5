//! What was asked for against what the drive's ledger says (invariants 1, 2 and 6).

use core::time::Duration;
use std::collections::BTreeMap;

use servocrab::axis::{Command, CommandId, Completion, Delivery, Failure, StopRequest};
use servocrab::profile_position::{BufferMode, MoveCommand, Reference};
use servocrab_sim::ds402::Executed;

use super::scenario::{RAMP, Scenario, Starts};
use super::world::{Frame, Issued, World};

/// Invariant 1.
pub fn once_or_not_at_all(scenario: &Scenario) -> Result<(), String> {
    let world = &scenario.world;
    for (issued, command, done) in world.moves() {
        let name = command.set_point.parameters.velocity;
        let lines: Vec<_> = lines_of(world.ledger(), name).collect();
        if lines.len() > 1 {
            return Err(format!("{issued:?} was executed twice: {lines:#?}"));
        }
        if let [line] = lines[..]
            && !belongs(line, &command, scenario.starts)
        {
            return Err(format!("{line:?} is not what {command:?} asked for"));
        }
        let accepted = world.accepted(issued.id).is_some();
        if by_an_edge(world, issued.id) && lines.is_empty() && !scenario.lies.ack {
            return Err(format!("{issued:?} was accepted and never executed"));
        }
        let sent = world
            .frames
            .iter()
            .any(|frame| frame.sent.bit(4) && Some(frame.sent.velocity) == name);
        if !accepted && done.is_some_and(says_not_sent) && sent {
            return Err(format!(
                "{issued:?} ended as {done:?}, and bit 4 was sent with its set-point; ledger {lines:?}"
            ));
        }
        if sent && done.is_some_and(|result| result.is_ok()) && !accepted {
            return Err(format!(
                "{issued:?} ended as {done:?} without an acknowledge"
            ));
        }
    }
    for line in world.ledger() {
        let asked = world
            .moves()
            .find(|(_, command, _)| command.set_point.parameters.velocity == Some(line.velocity));
        match asked {
            Some((issued, ..)) if issued.now <= line.latched_at => {}
            _ => return Err(format!("nobody asked for {line:?}")),
        }
    }
    Ok(())
}

/// Whether an edge of bit 12 under a high bit 4 has acknowledged this move. What replaces a full buffer gets none: the drive
/// may not have taken it (decision 0005).
fn by_an_edge(world: &World, id: CommandId) -> bool {
    world
        .accepted(id)
        .and_then(|report| world.frames.get(report.frame))
        .is_some_and(|frame| frame.sent.bit(4))
}

/// Invariant 6: by number, for moves that cannot be told apart.
pub fn equal_moves_all_count(scenario: &Scenario) -> Result<(), String> {
    let world = &scenario.world;
    let mut executed: BTreeMap<_, usize> = BTreeMap::new();
    for line in world.ledger() {
        let key = (line.value, line.relative, line.bit_5, line.bit_9);
        *executed.entry(key).or_default() += 1;
    }
    let mut asked: BTreeMap<_, (usize, usize)> = BTreeMap::new();
    for (issued, command, done) in world.moves() {
        let Some((bit_5, bit_9)) = start_bits(scenario.starts, command.set_point.buffer_mode)
        else {
            continue;
        };
        let relative = command.reference == Reference::Relative;
        let count = asked
            .entry((command.target, relative, bit_5, bit_9))
            .or_default();
        if by_an_edge(world, issued.id) {
            count.0 += 1;
        } else if !done.is_some_and(says_not_sent) {
            count.1 += 1;
        }
    }
    for (key, &count) in &executed {
        let (sure, unknown) = asked.get(key).copied().unwrap_or_default();
        if count > sure + unknown {
            return Err(format!(
                "{key:?} executed {count} times, asked for {sure} and perhaps {unknown} times"
            ));
        }
    }
    for (key, &(sure, _)) in &asked {
        let count = executed.get(key).copied().unwrap_or_default();
        if count < sure && !scenario.lies.ack {
            return Err(format!(
                "{key:?} executed {count} times and acknowledged {sure} times"
            ));
        }
    }
    Ok(())
}

/// Invariant 2: a motion begins only with a set-point whose move nobody has stopped, or that was resumed in words.
pub fn no_motion_unasked(scenario: &Scenario) -> Result<(), String> {
    if scenario.lies.blocked || scenario.lies.deaf {
        return Ok(());
    }
    let world = &scenario.world;
    let frames = &world.frames;
    let lag = Duration::from_millis(scenario.lag_cycles as u64 + 1);
    for at in 1..frames.len() {
        // The shaft of an axis that stands is pushed by loads; what the drive asks of it is its demand.
        let (Some((before, was)), Some((after, is))) = (frames[at - 1].demand, frames[at].demand)
        else {
            continue;
        };
        let begins = was == 0.0 && is != 0.0;
        if before == after && !begins {
            continue;
        }
        // An axis that is being stopped still moves.
        let slowing = was != 0.0 && is.abs() <= was.abs();
        if slowing {
            continue;
        }
        let until = frames[at].now + world.period;
        let since = frames[at - 1].now.saturating_sub(lag);
        let open: Vec<_> = world
            .ledger()
            .iter()
            .filter(|line| line.started_at.is_some_and(|started| started <= until))
            .filter(|line| line.ended_at.is_none_or(|ended| ended >= since))
            .collect();
        let asked = open.iter().any(|line| {
            world
                .moves()
                .filter(|(_, command, _)| {
                    command.set_point.parameters.velocity == Some(line.velocity)
                })
                .any(|(issued, ..)| !scenario_is_over(scenario, &issued, at))
        });
        if !asked && (begins || was == 0.0) {
            return Err(format!(
                "the axis begins to move at {:?} (frame {at}) with {open:#?}",
                frames[at].now
            ));
        }
    }
    Ok(())
}

/// Whether, when the axis moves after frame `at`, this move had been stopped, with the stop delivered before and no
/// resume after it, or had been reported as ended for good.
fn scenario_is_over(scenario: &Scenario, issued: &Issued, at: usize) -> bool {
    let world = &scenario.world;
    let late = Duration::from_millis(scenario.lag_cycles as u64 + 2);
    let slack = late.div_duration_f64(world.period).ceil() as usize;
    let delivered_since = |from: usize| {
        world.frames[from..at.saturating_sub(slack).max(from)]
            .iter()
            .any(|frame| frame.delivered)
    };
    if let Some((report, Err(failure))) = world.done(issued.id)
        && is_final(failure)
        && delivered_since(report.frame + 1)
    {
        return true;
    }
    let resumed_after = |from: usize| {
        world.issued.iter().any(|other| {
            other.frame >= from
                && other.frame <= at
                && other.command == Command::Resume
                && world
                    .done(other.id)
                    .is_some_and(|(_, result)| result == Ok(Completion::Done))
        })
    };
    stops(scenario)
        .filter(|(frame, _)| *frame > issued.frame && delivered_since(*frame))
        .any(|(frame, pauses)| !(pauses && resumed_after(frame)))
}

/// The frames with a stop request that was not refused, and whether it only pauses.
fn stops(scenario: &Scenario) -> impl Iterator<Item = (usize, bool)> + '_ {
    let world = &scenario.world;
    let lanes = world
        .frames
        .iter()
        .enumerate()
        .filter(|(_, frame): &(usize, &Frame)| !frame.lane.is_empty())
        .map(|(at, frame)| (at, frame.lane == StopRequest::HALT));
    let commands = world.issued.iter().filter_map(|issued| {
        let pauses = match issued.command {
            Command::Halt => true,
            Command::Stop | Command::QuickStop | Command::Disable | Command::Release => false,
            _ => return None,
        };
        let refused = matches!(
            world.done(issued.id),
            Some((report, Err(Failure::Busy | Failure::BusLost { .. } | Failure::Fault { .. })))
                if report.frame == issued.frame
        );
        (!refused).then_some((issued.frame, pauses))
    });
    lanes.chain(commands)
}

/// Whether no motion of this set-point may begin after this report.
const fn is_final(failure: Failure) -> bool {
    !matches!(
        failure,
        Failure::BusLost {
            delivery: Delivery::Unknown | Delivery::Accepted
        } | Failure::Timeout {
            delivery: Delivery::Unknown | Delivery::Accepted,
            ..
        } | Failure::MissedTarget { .. }
            | Failure::PerhapsSuperseded { .. }
    )
}

/// Whether the report says that the drive has not got the set-point.
pub fn says_not_sent(result: Result<Completion, Failure>) -> bool {
    matches!(
        result,
        Err(Failure::Withdrawn
            | Failure::Busy
            | Failure::Halted { .. }
            | Failure::NeedsStop
            | Failure::Moving
            | Failure::NotEnabled { .. }
            | Failure::Unsupported { .. }
            | Failure::Zero(_)
            | Failure::NotMapped(_)
            | Failure::Missing(_)
            | Failure::BusLost {
                delivery: Delivery::NotSent
            }
            | Failure::Timeout {
                delivery: Delivery::NotSent,
                ..
            })
    )
}

/// Bits 5 and 9 of each start, after the documents of the drives; none where the drive cannot do it.
pub const fn start_bits(starts: Starts, buffer_mode: BufferMode) -> Option<(bool, bool)> {
    match (starts, buffer_mode) {
        (Starts::Cia402 | Starts::WithoutBlend, BufferMode::Aborting) => Some((true, false)),
        (_, BufferMode::Buffered) => Some((false, false)),
        (Starts::Cia402, BufferMode::Blending) => Some((false, true)),
        (Starts::Ax2000, BufferMode::Blending) => Some((true, false)),
        (Starts::WithoutBlend, BufferMode::Blending) | (Starts::Ax2000, BufferMode::Aborting) => {
            None
        }
    }
}

fn belongs(line: &Executed, command: &MoveCommand, starts: Starts) -> bool {
    let parameters = command.set_point.parameters;
    line.value == command.target
        && line.relative == (command.reference == Reference::Relative)
        && Some((line.bit_5, line.bit_9)) == start_bits(starts, command.set_point.buffer_mode)
        && Some(line.velocity) == parameters.velocity
        && line.acceleration == parameters.acceleration.unwrap_or(RAMP)
        && line.deceleration == parameters.deceleration.unwrap_or(RAMP)
}

pub fn lines_of(ledger: &[Executed], name: Option<u32>) -> impl Iterator<Item = &Executed> {
    ledger
        .iter()
        .filter(move |line| Some(line.velocity) == name)
}
