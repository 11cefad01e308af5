//! Moves of several axes whose bits 4 rise in one cycle: all of them or none.

use core::{
    sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering},
    time::Duration,
};
use std::sync::Arc;

use crossbeam_queue::ArrayQueue;

use crate::{
    profile_position::{Move, MoveCommand, MoveRequest},
    wakes::{End, Waiters, Wakes},
};

use super::{
    AxisCore, AxisError, AxisErrorKind, Command, CommandId, Failure, pending::Pending,
    shared::Shared,
};

/// Groups that wait to start at once, of one network.
const GROUPS: usize = 16;
/// Those who sleep all wait on one channel.
const TIME: u32 = 0;

/// Where moves are asked to start together: one queue for all axes of a network, a clone in each [`AxisSetup`](super::AxisSetup).
/// With it goes the word that anything was asked of any of these axes.
///
/// ```
/// use servocrab::axis::GroupQueue;
/// let queue = GroupQueue::new();
/// let of_the_first_axis = queue.clone();
/// let groups = queue.groups();
/// # drop((of_the_first_axis, groups));
/// ```
#[derive(Debug, Clone)]
pub struct GroupQueue {
    queues: Arc<Queues>,
}

#[derive(Debug)]
struct Queues {
    /// Whether anything was stored for the bus thread with any of the axes, since it looked.
    asked: AtomicBool,
    /// How many futures wait for a change of any of the axes.
    watchers: AtomicUsize,
    /// How many cycles there were, where all axes are stepped together.
    cycles: AtomicU64,
    /// The time of the last cycle, and when the next of those who sleep is to be woken, in nanoseconds.
    now: AtomicU64,
    due: AtomicU64,
    sleepers: Arc<Waiters>,
    new: ArrayQueue<Arc<Group>>,
    /// Back to the program, so that the bus thread frees no memory.
    over: ArrayQueue<Arc<Group>>,
    /// Who wakes the futures of all axes.
    wakes: Wakes,
    /// None where somebody else ends it.
    _end: Option<End>,
}

#[derive(Debug)]
struct Group {
    members: Vec<Member>,
    fired: AtomicBool,
}

#[derive(Debug)]
struct Member {
    axis: usize,
    id: CommandId,
    shared: Arc<Shared>,
}

impl Default for GroupQueue {
    fn default() -> Self {
        Self::new()
    }
}

impl GroupQueue {
    /// An empty queue. Futures of its axes are woken on its own thread, `servocrab-wake`, so that no waker of the program can delay
    /// the loop that steps the axes.
    #[must_use]
    pub fn new() -> Self {
        match Wakes::start(None) {
            Ok((wakes, end)) => Self::of(wakes, Some(end)),
            Err(error) => {
                tracing::error!(%error, "there is no thread that wakes: the cycles wake, and wait for what they wake");
                Self::in_virtual_time()
            }
        }
    }

    /// An empty queue for a loop in virtual time: futures are woken by [`AxisPort::after_step`](super::AxisPort::after_step), on its
    /// thread, so that every run is the same.
    #[must_use]
    pub fn in_virtual_time() -> Self {
        let (wakes, end) = Wakes::in_turn();
        Self::of(wakes, Some(end))
    }

    /// An empty queue, and who wakes.
    pub(crate) fn with(wakes: &Wakes) -> Self {
        Self::of(wakes.clone(), None)
    }

    fn of(wakes: Wakes, end: Option<End>) -> Self {
        Self {
            queues: Arc::new(Queues {
                sleepers: wakes.waiters(),
                wakes,
                _end: end,
                asked: AtomicBool::new(false),
                watchers: AtomicUsize::new(0),
                cycles: AtomicU64::new(0),
                now: AtomicU64::new(0),
                due: AtomicU64::new(u64::MAX),
                new: ArrayQueue::new(GROUPS),
                over: ArrayQueue::new(2 * GROUPS),
            }),
        }
    }

    /// To be called after an axis has got a request.
    pub(super) fn ask(&self) {
        // Exchanged and not stored: the reader sees what each of several threads has asked for, and not the last one's alone.
        self.queues.asked.swap(true, Ordering::Release);
    }

    /// To be held by a task that waits for a change of any of the axes.
    pub(super) fn watch(&self) -> Watch<'_> {
        self.queues.watchers.fetch_add(1, Ordering::AcqRel);
        Watch(&self.queues)
    }

    /// Where the futures of an axis wait.
    pub(super) fn waiters(&self) -> Arc<Waiters> {
        self.queues.wakes.waiters()
    }

    /// Has those woken for whom there is something new.
    pub(super) fn hand_over(&self) {
        self.queues.wakes.hand_over();
    }

    /// How many cycles there were in which all axes were stepped, or left at rest.
    pub(super) fn cycles(&self) -> u64 {
        self.queues.cycles.load(Ordering::Acquire)
    }

    /// The network's time: that of its last cycle.
    pub(crate) fn now(&self) -> Duration {
        Duration::from_nanos(self.queues.now.load(Ordering::Acquire))
    }

    /// Sleeps until this moment of the network's time, which does not come once the network has ended.
    pub(crate) async fn sleep_until(&self, until: Duration) {
        let queues = &self.queues;
        let is_over = || {
            if self.now() >= until {
                return Some(());
            }
            queues.due.fetch_min(nanoseconds(until), Ordering::SeqCst);
            None
        };
        queues.sleepers.until(TIME, is_over).await;
    }

    /// Says what time it is; to be called once a cycle.
    pub(super) fn note_time(&self, now: Duration) {
        self.queues.note_time(now);
    }

    /// The bus thread's end. There is to be one.
    #[must_use]
    pub fn groups(&self) -> Groups {
        Groups {
            queues: Arc::clone(&self.queues),
            waiting: Vec::with_capacity(GROUPS),
        }
    }
}

impl Queues {
    #[inline]
    fn note_time(&self, now: Duration) {
        let now = nanoseconds(now);
        self.now.store(now, Ordering::Release);
        if now >= self.due.load(Ordering::Relaxed) {
            self.wake_sleepers();
        }
    }

    #[cold]
    fn wake_sleepers(&self) {
        // Who sleeps on says so again.
        self.due.store(u64::MAX, Ordering::SeqCst);
        self.sleepers.announce(TIME);
    }
}

fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

/// Somebody waits for a change.
pub(super) struct Watch<'a>(&'a Queues);

impl Drop for Watch<'_> {
    fn drop(&mut self) {
        self.0.watchers.fetch_sub(1, Ordering::AcqRel);
    }
}

/// The axes of a network, as [`Groups::advance`] asks for them.
pub trait AxisSet {
    /// The core of the axis with this number, and the outputs of its drive that are about to be sent.
    fn axis(&mut self, index: usize) -> Option<(&mut AxisCore, &mut [u8])>;
}

/// The groups that wait for their start.
#[derive(Debug)]
pub struct Groups {
    queues: Arc<Queues>,
    waiting: Vec<Arc<Group>>,
}

impl Groups {
    /// Whether any of the axes has been asked for anything since this was called last: else none of their ports needs to be
    /// looked at before sending.
    pub(crate) fn take_asked(&self) -> bool {
        self.queues.asked.swap(false, Ordering::AcqRel)
    }

    /// Whether anybody waits for a change of any of the axes, as far as [`stored`](crate::wakes::stored) was called before.
    pub(crate) fn are_watched(&self) -> bool {
        self.queues.watchers.load(Ordering::Relaxed) != 0
    }

    /// Says how many cycles there were; to be called when every axis was stepped and passed on, or left at rest.
    pub(crate) fn count_to(&self, cycles: u64) {
        self.queues.cycles.store(cycles, Ordering::Release);
    }

    /// Starts the groups of which every move has what it needs, and gives up those of which one has failed.
    ///
    /// To be called after [`AxisPort::before_send`](super::AxisPort::before_send) of every axis and right before
    /// sending: then no stop can come between the rise of one bit 4 and another.
    pub fn advance(&mut self, now: Duration, axes: &mut impl AxisSet) {
        self.queues.note_time(now);
        while self.waiting.len() < GROUPS
            && let Some(group) = self.queues.new.pop()
        {
            self.waiting.push(group);
        }
        let queues = &self.queues;
        self.waiting.retain(|group| {
            let over = group.advance(now, axes);
            if over {
                // Where there is no room it is freed here.
                let _ = queues.over.push(Arc::clone(group));
            }
            !over
        });
    }
}

impl Group {
    /// Whether there is nothing more to do for it.
    fn advance(&self, now: Duration, axes: &mut impl AxisSet) -> bool {
        let failed = |member: &Member| member.shared.is_done(member.id);
        if self.members.iter().any(failed) {
            self.withdraw(axes);
            return true;
        }
        let mut is_armed = |member: &Member| {
            axes.axis(member.axis)
                .is_some_and(|(core, _)| core.is_armed(member.id))
        };
        if !self.members.iter().all(&mut is_armed) {
            return false;
        }
        for member in &self.members {
            if let Some((core, outputs)) = axes.axis(member.axis) {
                core.fire(now, member.id, outputs);
            }
        }
        self.fired.store(true, Ordering::Release);
        true
    }

    fn withdraw(&self, axes: &mut impl AxisSet) {
        for member in &self.members {
            if let Some((core, outputs)) = axes.axis(member.axis) {
                core.withdraw(member.id, outputs);
                while let Some((id, event)) = core.poll_event() {
                    member.shared.report(id, event);
                }
            }
        }
    }
}

/// Starts moves of several axes of one network in one cycle (and one frame, where their drives share it): every bit 4 rises, or none
/// does. Resolves when all drives have acknowledged.
///
/// Dropped before the bits rose, nothing is started.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
/// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// # let drive = DriveConfig::new(drives::akd2g()).axis("x").axis("y");
/// # smol::block_on(async {
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// use servocrab::{axis, profile_position::SetPoint};
/// let (x, y) = (net.axis("x")?, net.axis("y")?);
/// x.enable().await?;
/// y.enable().await?;
/// let (on_x, on_y) = (x.profile_position().await?, y.profile_position().await?);
/// let set_point = SetPoint::new().velocity(50_000);
/// let moves = axis::together([on_x.rel(3_000, set_point), on_y.rel(1_000, set_point)]).await?;
/// for motion in &moves {
///     motion.done().await?;
/// }
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
///
/// # Errors
/// [`TogetherError`] with the first reason: before the bits rose it holds no move, and nothing was sent to any drive.
pub async fn together(
    requests: impl IntoIterator<Item = MoveRequest>,
) -> Result<Vec<Move>, TogetherError> {
    let requests: Vec<MoveRequest> = requests.into_iter().collect();
    let Some(first) = requests.first() else {
        return Ok(Vec::new());
    };
    let shared_of = |request: &MoveRequest| Arc::clone(&request.axis.handles.shared);
    let queues = &shared_of(first).setup.groups.queues;
    while queues.over.pop().is_some() {}
    for (n, request) in requests.iter().enumerate() {
        let shared = shared_of(request);
        let twice = requests
            .iter()
            .take(n)
            .any(|other| Arc::ptr_eq(&shared_of(other), &shared));
        if twice || !Arc::ptr_eq(&shared.setup.groups.queues, queues) {
            return Err(shared.error(AxisErrorKind::NotTogether).into());
        }
    }

    // In the order of the axes, so that two groups never wait for each other.
    let mut in_order: Vec<&MoveRequest> = requests.iter().collect();
    in_order.sort_by_key(|request| request.axis.handles.shared.setup.index);
    // A stop that comes while parameters are being written stops these moves as well.
    let asked: Vec<_> = in_order.iter().map(|request| request.last_stop()).collect();
    let mut prepared = Vec::new();
    let mut claims = Vec::new();
    for (request, asked) in in_order.into_iter().zip(asked) {
        let (command, claim) = request.prepare().await?;
        prepared.push((request, command, asked));
        claims.push(claim);
    }
    // Dropped on the way out, what was submitted is withdrawn.
    let mut pending: Vec<Pending> = Vec::new();
    for ((request, command, asked), claim) in prepared.iter().zip(claims) {
        let command = MoveCommand {
            gated: true,
            ..*command
        };
        let submitted = request.axis.submit_motion(Command::Move(command), *asked)?;
        if let Some(claim) = claim {
            claim.sent(&submitted);
        }
        pending.push(submitted);
    }
    let group = Arc::new(Group {
        members: prepared
            .iter()
            .zip(&pending)
            .map(|((request, ..), pending)| Member {
                axis: request.axis.handles.shared.setup.index,
                id: pending.id,
                shared: shared_of(request),
            })
            .collect(),
        fired: AtomicBool::new(false),
    });
    if queues.new.push(Arc::clone(&group)).is_err() {
        return Err(shared_of(first).error(AxisErrorKind::QueueFull).into());
    }

    let mut started = Vec::new();
    let mut errors = Vec::new();
    for ((request, ..), pending) in prepared.iter().zip(pending) {
        match request.accepted(pending).await {
            Ok(accepted) => started.push((*request, accepted)),
            Err(error) => errors.push(error),
        }
    }
    // As they were asked for.
    started.sort_by_key(|(of, _)| {
        requests
            .iter()
            .position(|request| core::ptr::eq(*of, request))
    });
    let started = started.into_iter().map(|(_, accepted)| accepted).collect();
    // The one that failed by itself says more than those that were withdrawn for it.
    let own = errors
        .iter()
        .position(|error| error.failure() != Some(Failure::Withdrawn));
    if errors.is_empty() {
        Ok(started)
    } else {
        Err(TogetherError {
            error: errors.swap_remove(own.unwrap_or(0)),
            fired: group.fired.load(Ordering::Acquire),
            started,
        })
    }
}

/// Moves did not all start together.
#[derive(Debug, thiserror::Error)]
#[error("{error}")]
pub struct TogetherError {
    /// The first reason.
    pub error: AxisError,
    /// Whether the bits 4 had risen: without it, no drive has seen anything of the moves.
    pub fired: bool,
    /// The moves that their drives have acknowledged all the same. Dropping them does not stop them.
    pub started: Vec<Move>,
}

impl From<AxisError> for TogetherError {
    fn from(error: AxisError) -> Self {
        Self {
            error,
            fired: false,
            started: Vec::new(),
        }
    }
}

impl From<TogetherError> for AxisError {
    fn from(error: TogetherError) -> Self {
        error.error
    }
}
