//! What the axis reported, and when (invariants 4, 7 and 9).

use core::time::Duration;

use servocrab::axis::{Command, CommandId, Completion, Event, Failure};
use servocrab::profile_position::{BufferSignal, Reference};
use servocrab_sim::ds402::{Cause, Outcome};

use super::orders::lines_of;
use super::scenario::Scenario;
use super::words::{enabled, in_fault};
use super::world::{Got, Phase};

/// Invariant 4.
pub fn reached_is_true(scenario: &Scenario) -> Result<(), String> {
    let world = &scenario.world;
    let tolerance = world.config.tolerances.position;
    for (issued, command, _) in world.moves() {
        let Some((report, result)) = world.done(issued.id) else {
            continue;
        };
        let line = lines_of(world.ledger(), command.set_point.parameters.velocity).next();
        let Some(frame) = world.frames.get(report.frame) else {
            continue;
        };
        let fail = |what: &str| {
            Err(format!(
                "{what}: {command:?} ended as {result:?} in frame {} at {:?}; {:?}; {line:?}",
                report.frame, report.now, frame.sample
            ))
        };
        // Where bit 12 shows the end of a set-point with another behind it, the drive's word is all there is, and where a
        // relative move ends is not always known to the host.
        let followed = world.reports.iter().any(|other| {
            other.event == Event::Accepted
                && other.frame <= report.frame
                && world
                    .accepted(issued.id)
                    .is_some_and(|own| own.frame < other.frame)
        });
        let told = followed && world.config.traits.buffer_signal == BufferSignal::Acknowledge;
        match result {
            Ok(Completion::Reached { position } | Completion::Passed { position }) => {
                let (Got::Fresh | Got::Answered, Some(_), Phase::Step) =
                    (frame.got, frame.sample, report.phase)
                else {
                    return fail("from inputs that did not arrive");
                };
                if frame.sent.bit(8) {
                    return fail("on a halted axis");
                }
                let Some(line) = line else {
                    if scenario.lies.ack {
                        continue;
                    }
                    return fail("without being executed");
                };
                if told && scenario.lies.ack {
                    continue;
                }
                let there =
                    |end: i64| (end - i64::from(position)).unsigned_abs() <= u64::from(tolerance);
                let ended = line.ended_at.is_some_and(|ended| ended <= report.now)
                    && matches!(line.outcome, Outcome::Reached | Outcome::Passed);
                // A way within the tolerance needs no motion to be done.
                let short = line.target.is_some_and(there) && line.start_position.is_none_or(there);
                // Resumed where it ends: the drive closes its books a cycle later.
                let stands = frame.velocity == 0.0 && there(frame.position);
                // Replaced, and not acknowledged yet, by a way to an end that is the same within the tolerance.
                let carried_on = line.outcome == Outcome::Replaced
                    && world.ledger().iter().any(|next| {
                        let ends = next.target.zip(line.target);
                        next.started_at.is_some()
                            && next.started_at == line.ended_at
                            && ends.is_some_and(|(a, b)| a.abs_diff(b) <= u64::from(tolerance))
                    });
                let stands = stands && line.target.is_some_and(there);
                // The drive went into a stop of its own, and Enable operation, as it is sent on, led it back (transition 16)
                // before it showed that. Where its set-point leads is not known to the host either: nothing tells.
                let accepted = world.accepted(issued.id).map_or(0, |own| own.frame);
                let stopped_unseen = line.outcome == Outcome::Discarded(Cause::QuickStop)
                    && command.reference == Reference::Relative
                    && world.frames[accepted..=report.frame]
                        .iter()
                        .filter_map(|frame| frame.sample)
                        .all(|sample| enabled(&sample));
                if !(ended || short || stands || carried_on || stopped_unseen) {
                    return fail("before the drive was there");
                }
                if let Ok(Completion::Passed { .. }) = result {
                    continue;
                }
                if command.reference == Reference::Relative || told {
                    continue;
                }
                let asked = i64::from(command.target);
                // A blocked shaft is where it was asked to be, and the drive says target reached: that its demand has gone
                // to a limit of its own elsewhere shows in nothing.
                let held_there = scenario.lies.blocked && frame.velocity == 0.0 && there(asked);
                let elsewhere = line
                    .target
                    .is_none_or(|end| end.abs_diff(asked) > u64::from(tolerance));
                if elsewhere && !held_there {
                    return fail("of another target than the one asked for");
                }
                if !followed && !there(i64::from(command.target)) {
                    return fail("outside the tolerance");
                }
            }
            Err(Failure::MissedTarget { target, actual }) => {
                if target.abs_diff(actual) <= tolerance {
                    return fail("a target that was not missed");
                }
                let since = report.now.saturating_sub(world.config.tolerances.settle);
                let stood = world.frames[..=report.frame]
                    .iter()
                    .rev()
                    .skip(world.latency + 1)
                    .take_while(|frame| frame.now > since)
                    .all(|frame| {
                        frame.position.abs_diff(i64::from(actual)) <= u64::from(tolerance) + 1
                    });
                // With another one behind it, it is over when the drive goes on to that, and the ledger knows where.
                let over = told
                    && line.is_some_and(|line| {
                        let elsewhere =
                            |end: i64| end.abs_diff(i64::from(target)) > u64::from(tolerance);
                        line.ended_at.is_some_and(|ended| ended <= report.now)
                            && line.end_position.is_some_and(elsewhere)
                    });
                // Its last way may be within the tolerance of where it was seen to stand: it has ended there all the same.
                let ended_there = line.is_some_and(|line| {
                    let there = |end: i64| end.abs_diff(i64::from(actual)) <= u64::from(tolerance);
                    line.ended_at.is_some_and(|ended| ended <= report.now)
                        && line.end_position.is_some_and(there)
                });
                if !(stood || over || ended_there || told && scenario.lies.ack) {
                    return fail("while it moved");
                }
            }
            _ => {}
        }
    }
    Ok(())
}

/// Invariant 7.
pub fn stale_advances_nothing(scenario: &Scenario) -> Result<(), String> {
    let world = &scenario.world;
    let loss = world.config.loss;
    let (mut stale, mut undelivered) = (0, 0);
    let mut was_lost = false;
    for (at, frame) in world.frames.iter().enumerate() {
        stale = if frame.got == Got::Stale {
            stale + 1
        } else {
            0
        };
        undelivered = if frame.got == Got::Fresh {
            0
        } else {
            undelivered + 1
        };
        let lost = (was_lost && frame.got != Got::Fresh)
            || stale >= loss.stale_cycles
            || undelivered >= loss.undelivered_cycles;
        if lost != frame.lost_after {
            return Err(format!(
                "frame {at}: lost {} after {stale} stale and {undelivered} undelivered cycles",
                frame.lost_after
            ));
        }
        let newly = lost && !was_lost;
        was_lost = lost;
        let next = world.frames.get(at + 1);
        let changed = next.is_some_and(|next| next.before != frame.sent);
        if frame.got == Got::Stale && !newly && changed {
            return Err(format!(
                "frame {at}: stale inputs changed {:?} to {:?}",
                frame.sent,
                next.map(|next| next.before)
            ));
        }
        // That bit 8 fell, and who waited for the halt that it ends: the frame was sent, whatever came back.
        let resumes = |id: CommandId| {
            world.issued.iter().any(|issued| {
                issued.id == id && matches!(issued.command, Command::Resume | Command::Halt)
            })
        };
        let is_resume_sent = |id, event| {
            let told = matches!(
                event,
                Event::Done(Ok(Completion::Done) | Err(Failure::Superseded))
            );
            told && resumes(id)
        };
        let of_step = || {
            world
                .reports
                .iter()
                .filter(move |report| report.frame == at && report.phase == Phase::Step)
        };
        if frame.got == Got::Stale
            && let Some(report) = of_step().find(|report| {
                let lost = matches!(report.event, Event::Done(Err(Failure::BusLost { .. })));
                let silent = stale == loss.stale_cycles;
                !((newly || silent) && lost || is_resume_sent(report.id, report.event))
            })
        {
            return Err(format!("frame {at}: stale inputs led to {report:?}"));
        }
        // Of a drive that answers, stops end by what it shows.
        let goes_on = |command| {
            let stops = matches!(
                command,
                Command::Halt
                    | Command::Stop
                    | Command::QuickStop
                    | Command::Disable
                    | Command::Release
            );
            stops && frame.got == Got::Answered
        };
        if newly || (lost && stale == loss.stale_cycles) {
            let open = world.issued.iter().find(|issued| {
                issued.frame <= at
                    && !goes_on(issued.command)
                    && world
                        .done(issued.id)
                        .is_none_or(|(report, _)| report.frame > at)
            });
            if let Some(open) = open {
                return Err(format!("frame {at}: {open:?} outlives the bus"));
            }
            if let Some(next) = next
                && frame.sent.word & 0x000F == 0x000F
                && next.sent.word & 0x0006 == 0x0006
                && frame.sample.is_none()
                && !was_in_fault(scenario, at)
            {
                return Err(format!(
                    "frame {at}: a lost drive is commanded on with {:04X}",
                    next.sent.word
                ));
            }
        }
    }
    Ok(())
}

/// Whether the last inputs up to this frame's showed a fault.
fn was_in_fault(scenario: &Scenario, at: usize) -> bool {
    let sample = scenario.world.frames[..=at]
        .iter()
        .rev()
        .find_map(|frame| frame.sample);
    sample.is_some_and(|sample| in_fault(&sample))
}

/// Invariant 9.
pub fn everything_ends(scenario: &Scenario) -> Result<(), String> {
    let world = &scenario.world;
    let deadlines = world.config.deadlines;
    for issued in &world.issued {
        let told: Vec<_> = world
            .reports
            .iter()
            .filter(|report| report.id == issued.id)
            .collect();
        let ends = told
            .iter()
            .filter(|report| matches!(report.event, Event::Done(_)))
            .count();
        let accepted = told
            .iter()
            .filter(|report| report.event == Event::Accepted)
            .count();
        let last_is_the_end = told
            .last()
            .is_some_and(|report| matches!(report.event, Event::Done(_)));
        if ends != 1 || !last_is_the_end || accepted > 1 {
            return Err(format!("{issued:?} was told {told:#?}"));
        }
        let halted_first = told.first().is_some_and(|r| r.event == Event::Halted);
        if halted_first {
            return Err(format!("{issued:?} was told {told:#?}"));
        }
        let Some((report, result)) = world.done(issued.id) else {
            continue;
        };
        let slack = 60 * world.period + Duration::from_millis(10);
        let within = match issued.command {
            Command::Enable => deadlines.enable,
            Command::ResetFault => {
                3 * (deadlines.fault_reset + Duration::from_millis(100)) + deadlines.standstill
            }
            // Behind one that was taken back it waits for that first.
            Command::SelectMode(_) | Command::PrepareMode(_) => deadlines.mode.saturating_mul(2),
            Command::Resume => Duration::ZERO,
            Command::Halt | Command::QuickStop => deadlines.standstill + deadlines.disable,
            Command::Stop | Command::Release => 2 * deadlines.standstill + deadlines.disable,
            Command::Disable => 2 * deadlines.standstill + deadlines.disable,
            Command::Move(_) | Command::Home(_) | Command::Jog(_) => Duration::MAX,
            Command::CheckMove(_)
            | Command::CheckHome
            | Command::CheckJog(_)
            | Command::SetLimits(_) => Duration::ZERO,
            other => return Err(format!("no rule for {other:?}")),
        };
        let took = report.now.saturating_sub(issued.now);
        if took > within.saturating_add(slack) {
            return Err(format!("{issued:?} took {took:?}: {result:?}"));
        }
        let halted = world
            .frames
            .get(scenario.last_stop)
            .is_some_and(|frame| frame.before.bit(8));
        if report.frame >= scenario.last_stop && issued.frame < scenario.last_stop && !halted {
            return Err(format!(
                "{issued:?} does not end although nothing disturbs it ({told:?}, quiet from frame {}, to {})",
                scenario.quiet_from, scenario.last_stop
            ));
        }
        if let (
            Err(Failure::Timeout {
                statusword,
                controlword,
                ..
            }),
            Phase::Step,
        ) = (result, report.phase)
            && let Some(frame) = world.frames.get(report.frame)
            && (Some(statusword) != frame.sample.map(|sample| sample.statusword)
                || controlword.bits() != frame.sent.word)
        {
            return Err(format!(
                "{result:?} does not name the last words of {frame:?}"
            ));
        }
    }
    Ok(())
}
