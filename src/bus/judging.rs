//! The rule of who answered in a datagram that several drives share, and whose outputs were delivered.

use super::drive_data::{Answer, Drives, are_equal};
use super::exchange::Events;
use super::packing::{Part, Sign};
use crate::profile_position::WorkingCounter;

/// What was judged of a datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Verdict {
    /// Its working counter was right.
    pub(super) right: bool,
    /// Moreover all of its drives are [`Answer::Fresh`], as far as it is their datagram.
    pub(super) fresh: bool,
    /// Moreover nobody counts as lost, and the working counter is everybody's: with the same one again, only inputs that are
    /// others need to be looked at.
    pub(super) calm: bool,
    /// It has brought other inputs than the one before.
    pub(super) changed: bool,
    /// Its working counter, where that came back and was wrong although all of its drives answer, but for those that are lost.
    pub(super) miscounted: Option<WorkingCounter>,
}

/// Takes the inputs of the drives that share a datagram. An answer that is not [`Answer::Fresh`] is noted with the drive, and
/// so are other inputs than before.
pub(super) fn judge_part(
    part: &Part,
    answer: Option<&[u8]>,
    cycle: u64,
    drives: &mut Drives,
    events: &mut Events,
) -> Verdict {
    let counter = answer
        .and_then(|answer| answer.get(part.data.end..part.data.end + 2))
        .and_then(|bytes| <[u8; 2]>::try_from(bytes).ok())
        .map(u16::from_le_bytes);
    let bytes = answer.unwrap_or_default();
    let mut expected = 0;
    let (mut silent, mut lost, mut changed) = (false, false, false);
    for share in &part.shares {
        let Some(drive) = drives.get_mut(share.drive) else {
            continue;
        };
        if drive.away {
            drive.answer = Answer::Stale;
            expected += share.counts;
            (silent, lost) = (true, true);
            continue;
        }
        let answered = match &share.inputs {
            Some(area) => drive.take_answer(bytes.get(area.clone()), cycle),
            None => drive.is_counted(counter),
        };
        if answered && drive.lost {
            events.membership = true;
            drive.lost = false;
        }
        silent |= drive.answer == Answer::Stale;
        lost |= drive.lost;
        changed |= drive.changed;
        if !drive.lost {
            expected += share.counts;
        }
    }
    let all = counter == Some(expected);
    if silent && all {
        changed |= take_equal_to_the_pattern(part, bytes, drives);
    }
    let right = all || is_right_with_closed_outputs(part, drives, expected, counter);
    // One that is silent, and not yet lost, is not counted: that tells enough.
    let is_explained = part.shares.iter().any(|share| {
        let drive = drives.get(share.drive);
        drive.is_some_and(|drive| drive.answer == Answer::Stale && !drive.lost)
    });
    let miscounted = counter.filter(|_| !right).map(|got| WorkingCounter {
        datagram: part.number,
        expected,
        got,
        devices: u16::try_from(part.shares.len()).unwrap_or(u16::MAX),
    });
    if !right {
        doubt(part, miscounted, drives);
    }
    let fresh = right && !silent;
    Verdict {
        right,
        fresh,
        // Where nobody is to count, that nobody has says something only of who has left OP.
        calm: fresh && all && !lost && expected > 0,
        changed,
        miscounted: miscounted.filter(|_| !is_explained),
    }
}

/// As [`judge_part`], where nobody was silent in the cycle before, and the verdict on this datagram was a calm one: from both
/// answers. None if its working counter is another one now.
pub(super) fn judge_calmly(
    part: &Part,
    answer: &[u8],
    before: &[u8],
    cycle: u64,
    drives: &mut Drives,
) -> Option<Verdict> {
    let end = part.data.end + 2;
    let (answer, before) = (answer.get(..end)?, before.get(..end)?);
    let (mut silent, mut changed) = (false, false);
    if answer.get(part.data.start..) != before.get(part.data.start..) {
        if answer.last_chunk::<2>() != before.last_chunk() {
            return None;
        }
        for share in &part.shares {
            if let Some(area) = &share.inputs
                && let Some(bytes) = answer.get(area.clone())
                && let Some(old) = before.get(area.clone())
                && !are_equal(bytes, old)
                && let Some(drive) = drives.get_mut(share.drive)
            {
                silent |= !drive.take_other(bytes, cycle);
                changed = true;
            }
        }
        if silent {
            take_equal_to_the_pattern(part, answer, drives);
        }
    }
    Some(Verdict {
        right: true,
        fresh: !silent,
        calm: !silent,
        changed,
        miscounted: None,
    })
}

/// Whether what the working counter lacks are outputs of drives that have left OP, or drives that are being set up anew.
fn is_right_with_closed_outputs(
    part: &Part,
    drives: &Drives,
    expected: u16,
    counter: Option<u16>,
) -> bool {
    let closed = part.shares.iter().filter_map(|share| {
        let drive = drives.get(share.drive)?;
        if drive.away {
            return Some(share.counts);
        }
        let is_closed = share.outputs.is_some() && drive.fallen && !drive.lost;
        is_closed.then(|| share.counts - u16::from(share.inputs.is_some()))
    });
    let closed: u16 = closed.sum();
    counter.is_some_and(|counter| (expected - closed..=expected).contains(&counter))
}

/// It is not known whose outputs were delivered.
fn doubt(part: &Part, miscounted: Option<WorkingCounter>, drives: &mut Drives) {
    drives.doubted = true;
    for share in &part.shares {
        if let Some(drive) = drives.get_mut(share.drive)
            && drive.answer == Answer::Fresh
        {
            drive.answer = Answer::Answered;
            drive.miscounted = miscounted;
        }
    }
}

/// Everybody has answered: whose inputs are equal to the pattern, has them so. Whether any are others than before.
fn take_equal_to_the_pattern(part: &Part, answer: &[u8], drives: &mut Drives) -> bool {
    let mut changed = false;
    for share in &part.shares {
        if let Some(drive) = drives.get_mut(share.drive)
            && drive.sign == Sign::AnyBits
            && drive.answer == Answer::Stale
            && !drive.lost
            && let Some(inputs) = &share.inputs
            && let Some(bytes) = answer.get(inputs.clone())
        {
            drive.take(bytes);
            drive.answer = Answer::Fresh;
            changed |= drive.changed;
        }
    }
    changed
}
