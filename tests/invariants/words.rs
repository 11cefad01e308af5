//! The words that went over the wire (invariants 3, 5 and 8).

use core::time::Duration;

use servocrab::axis::{Command, Completion, StopRequest};
use servocrab::profile_position::{MoveCommand, Reference};

use super::orders::start_bits;
use super::scenario::{RAMP, Scenario, Starts};
use super::world::{DRIVE_CYCLE, Got, Outputs, Sample, World};

const OPERATION_ENABLED: u16 = 0x0027;
const OF_STATE: u16 = 0x006F;

/// Moves that are acknowledged and have no outcome yet when frame `at` is sent.
fn accepted_and_open(scenario: &Scenario, at: usize) -> usize {
    let world = &scenario.world;
    world
        .moves()
        .filter(|(issued, ..)| world.accepted(issued.id).is_some_and(|r| r.frame < at))
        .filter(|(issued, ..)| world.done(issued.id).is_none_or(|(r, _)| r.frame >= at))
        .count()
}

/// Invariant 3.
pub fn bit_4_rises_by_the_rules(scenario: &Scenario) -> Result<(), String> {
    let frames = &scenario.world.frames;
    // Since when bit 4 is known to have been delivered low, and whether bit 12 was high then.
    let mut low: Option<(Duration, bool)> = None;
    let mut last_seen: Option<Sample> = None;
    for at in 0..frames.len() {
        let sent = frames[at].sent;
        let before = at.checked_sub(1).map(|at| &frames[at]);
        let was_high = before.is_some_and(|frame| frame.sent.bit(4));
        if sent.bit(4) && !was_high {
            let Some(before) = before else {
                return Err("bit 4 in the first word".into());
            };
            let (Got::Fresh, Some(shown)) = (before.got, before.sample) else {
                return Err(format!(
                    "frame {at}: bit 4 rises on {:?} inputs",
                    before.got
                ));
            };
            // Onto a full buffer bit 12 stays high; only what replaces all it holds may go there, and no distance. One more may be
            // over and its outcome still open.
            let full = sent.bit(5)
                && !sent.bit(6)
                && scenario.starts != Starts::Ax2000
                && accepted_and_open(scenario, at) >= 2;
            if !enabled(&shown) || shown.mode != 1 || (shown.bit(12) && !full) {
                return Err(format!("frame {at}: bit 4 rises on {shown:?}"));
            }
            let seen = low.is_some_and(|(since, acknowledge)| {
                (acknowledge && !shown.bit(12)) || before.now - since >= 2 * DRIVE_CYCLE
            });
            if !seen {
                return Err(format!(
                    "frame {at}: bit 4 rises before the drive has surely seen it low ({low:?})"
                ));
            }
            if sent.word & 0x018F != 0x000F || sent.mode != 1 {
                return Err(format!("frame {at}: bit 4 rises in {sent:?}"));
            }
            let asked = scenario.world.moves().any(|(issued, command, _)| {
                let alive = scenario
                    .world
                    .done(issued.id)
                    .is_none_or(|(r, _)| r.frame >= at);
                issued.frame <= at && alive && belongs(&sent, &command, scenario.starts)
            });
            if !asked {
                return Err(format!("frame {at}: nobody asks for {sent:?}"));
            }
        }
        if sent.bit(4) && was_high {
            let same = before.is_some_and(|frame| {
                (sent.word & 0x0270, sent.target, sent.velocity)
                    == (
                        frame.sent.word & 0x0270,
                        frame.sent.target,
                        frame.sent.velocity,
                    )
                    && sent.acceleration == frame.sent.acceleration
                    && sent.deceleration == frame.sent.deceleration
            });
            // While a fault stops the axis no word of ours counts, and the word stays.
            if !same && !last_seen.is_some_and(|sample| in_fault(&sample)) {
                return Err(format!(
                    "frame {at}: the set-point changes under a high bit 4: {sent:?}"
                ));
            }
        }
        last_seen = frames[at].sample.or(last_seen);
        if sent.bit(4) {
            low = None;
        } else if low.is_none() && frames[at].got == Got::Fresh {
            let acknowledge = frames[at].sample.is_some_and(|sample| sample.bit(12));
            low = Some((frames[at].now, acknowledge));
        }
    }
    Ok(())
}

fn belongs(sent: &Outputs, command: &MoveCommand, starts: Starts) -> bool {
    let parameters = command.set_point.parameters;
    sent.target == command.target
        && sent.bit(6) == (command.reference == Reference::Relative)
        && Some((sent.bit(5), sent.bit(9))) == start_bits(starts, command.set_point.buffer_mode)
        && Some(sent.velocity) == parameters.velocity
        && sent.acceleration == parameters.acceleration.unwrap_or(RAMP)
        && sent.deceleration == parameters.deceleration.unwrap_or(RAMP)
}

/// Invariant 5.
pub fn no_bit_outlives(scenario: &Scenario) -> Result<(), String> {
    let world = &scenario.world;
    let frames = &world.frames;
    let mut last_seen: Option<Sample> = None;
    let mut rises_of_7 = 0;
    for at in 0..frames.len() {
        let sent = frames[at].sent;
        let before = at.checked_sub(1).map_or(0, |at| frames[at].sent.word);
        let had = |bit: u16| before & (1 << bit) != 0;
        let fail = |what: &str| {
            Err(format!(
                "frame {at}: {what}: {:04X} after {before:04X}, last seen {last_seen:?}",
                sent.word
            ))
        };
        if sent.word & 0xFC00 != 0 {
            return fail("bits that nobody set");
        }
        if !sent.bit(4) && sent.word & 0x0260 != 0 {
            return fail("bit 5, 6 or 9 without bit 4");
        }
        if sent.bit(7) {
            let resets = world.issued.iter().any(|issued| {
                issued.command == Command::ResetFault
                    && issued.frame < at
                    && world
                        .done(issued.id)
                        .is_none_or(|(report, _)| report.frame >= at)
            });
            if !resets {
                return fail("bit 7 without a reset under way");
            }
            if sent.word != 0x0080 {
                return fail("bit 7 with other bits");
            }
            rises_of_7 += usize::from(!had(7));
        }
        let issued_now = || world.issued.iter().filter(|issued| issued.frame == at);
        if sent.bit(8) && !had(8) {
            let by_lane = frames[at]
                .lane
                .intersects(StopRequest::HALT | StopRequest::STOP);
            let by_command = issued_now().any(|issued| {
                matches!(
                    issued.command,
                    Command::Halt | Command::Stop | Command::Release | Command::Disable
                )
            });
            if !by_lane && !by_command {
                return fail("bit 8 rises and nobody halts");
            }
        }
        if !sent.bit(8) && had(8) {
            let resumed = issued_now().any(|issued| {
                issued.command == Command::Resume
                    && world
                        .done(issued.id)
                        .is_some_and(|(_, result)| result == Ok(Completion::Done))
            });
            let in_operation = last_seen.is_none_or(|sample| enabled(&sample));
            let leaves = sent.word & 0x0002 == 0;
            if in_operation && !resumed && !leaves && !is_lent(world, at) {
                return fail("bit 8 falls in Operation enabled and nobody resumes");
            }
        }
        last_seen = frames[at].sample.or(last_seen);
    }
    let resets = world
        .issued
        .iter()
        .filter(|issued| issued.command == Command::ResetFault);
    if rises_of_7 > 3 * resets.count() {
        return Err(format!("{rises_of_7} edges of bit 7"));
    }
    Ok(())
}

/// Whether bit 8 was up to this frame that of a stop alone, which nobody's halt has shared, and the drive holds no set-point: then there was
/// nothing to abandon.
fn is_lent(world: &World, at: usize) -> bool {
    let frames = &world.frames;
    let rose = (0..at)
        .rev()
        .find(|&frame| !frames[frame].sent.bit(8))
        .map_or(0, |before| before + 1);
    let halts = frames[rose..=at]
        .iter()
        .any(|frame| frame.lane.contains(StopRequest::HALT))
        || world
            .issued
            .iter()
            .any(|issued| (rose..=at).contains(&issued.frame) && issued.command == Command::Halt);
    let now = frames[at].now;
    let holds = world
        .ledger()
        .iter()
        .any(|line| line.latched_at <= now && line.ended_at.is_none_or(|ended| ended > now));
    !halts && !holds
}

/// Invariant 8.
pub fn stops_come_first(scenario: &Scenario) -> Result<(), String> {
    let world = &scenario.world;
    let frames = &world.frames;
    let mut last_seen: Option<Sample> = None;
    for at in 1..frames.len() {
        last_seen = frames[at - 1].sample.or(last_seen);
        let frame = &frames[at];
        let sent = frame.sent;
        let mut asked = frame.lane;
        for issued in world.issued.iter().filter(|issued| issued.frame == at) {
            match issued.command {
                Command::Halt => asked |= StopRequest::HALT,
                Command::Stop | Command::Release | Command::Disable => asked |= StopRequest::STOP,
                Command::QuickStop => asked |= StopRequest::QUICK_STOP,
                _ => {}
            }
        }
        let fault =
            last_seen.is_some_and(|sample| matches!(sample.statusword.bits() & 0x4F, 8 | 0xF));
        let fail = |what: &str| {
            Err(format!(
                "frame {at}: {what}: {asked:?}, {:04X} would have been sent, {:04X} was; {last_seen:?}",
                frame.before.word, sent.word
            ))
        };
        let quick_before = frames[at - 1].sent.word & 0x000F == 0x000B;
        if quick_before && last_seen.is_some_and(|sample| enabled(&sample)) && sent.bit(2) {
            return fail("a quick stop is taken back in Operation enabled");
        }
        if asked.is_empty() {
            continue;
        }
        if sent.bit(4) && !frames[at - 1].sent.bit(4) {
            return fail("bit 4 rises beside a stop");
        }
        if fault || frame.before.word & 0x000F != 0x000F {
            continue;
        }
        let quick = !sent.bit(2);
        // Less than the tolerance may be left to go where the actual position lags. What moves after the next rise of bit 4 is
        // another motion.
        let place = frames[at - 1].position;
        let until_the_next = frames[at - 1..]
            .windows(2)
            .take_while(|pair| !pair[1].sent.bit(4) || pair[0].sent.bit(4));
        let stays = until_the_next.take(10).all(|pair| {
            pair[1].position.abs_diff(place) <= u64::from(world.config.tolerances.position)
        });
        let idle = (frames[at - 1].velocity == 0.0 || stays)
            && world.ledger().iter().all(|line| {
                line.latched_at > frame.now || line.ended_at.is_some_and(|ended| ended <= frame.now)
            });
        // On its way down already, standing: shutdown leads out of Operation enabled as well.
        let down = sent.word & 0x000F != 0x000F && idle;
        // A resume takes back a halt of an axis that stands and has nothing to go on with.
        let resumed = world.issued.iter().any(|issued| {
            issued.frame == at
                && issued.command == Command::Resume
                && world
                    .done(issued.id)
                    .is_some_and(|(_, result)| result == Ok(Completion::Done))
        });
        let ok = if down || (idle && resumed && frame.lane.is_empty()) {
            true
        } else if asked.contains(StopRequest::QUICK_STOP) {
            quick
        } else if asked.contains(StopRequest::HALT) {
            quick || sent.bit(8)
        } else {
            quick || sent.bit(8) || idle
        };
        if !ok {
            return fail("the stop is not in the next word");
        }
    }
    Ok(())
}

/// Fault or Fault reaction active.
pub fn in_fault(sample: &Sample) -> bool {
    matches!(sample.statusword.bits() & 0x004F, 0x0008 | 0x000F)
}

/// Operation enabled.
pub fn enabled(sample: &Sample) -> bool {
    sample.statusword.bits() & OF_STATE == OPERATION_ENABLED
}
