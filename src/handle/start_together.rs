//! Moves of several axes whose bits 4 rise in one cycle: all of them or none.

use core::{
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};
use std::sync::{Arc, Mutex, PoisonError};

use crossbeam_queue::ArrayQueue;

use crate::{
    Failure,
    axis::AxisCore,
    profile_position::MoveCommand,
    units::AxisUnit,
    wakes::{End, Wakes},
};

use super::{
    AxisError, AxisErrorKind, Move, MoveRequest, SkewReport,
    pair::{PairQueues, PairWatches},
    pending::Pending,
    profile_position::{CountsRequest, SplitMove},
    request::AxisRequest,
    shared::Shared,
    signals::NetworkSignals,
    stops::LastStop,
};

/// Groups that wait to start at once, of one network.
const GROUPS: usize = 16;

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
    pub(super) signals: Arc<NetworkSignals>,
}

#[derive(Debug)]
struct Queues {
    /// Held while the moves of a group are submitted, so that of two groups one is first on all axes. The bus thread never takes it.
    submits: Mutex<()>,
    new: ArrayQueue<Arc<Group>>,
    /// Back to the program, so that the bus thread frees no memory.
    over: ArrayQueue<Arc<Group>>,
    pairs: Arc<PairQueues>,
}

#[derive(Debug)]
struct Group {
    members: Vec<GroupMember>,
    fired: AtomicBool,
}

#[derive(Debug)]
struct GroupMember {
    axis: usize,
    request: Arc<AxisRequest>,
    /// The lease that it is of.
    lease: u64,
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
                tracing::error!(target: crate::log_target::BUS, %error, "there is no thread that wakes: the cycles wake, and wait for what they wake");
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
            signals: Arc::new(NetworkSignals::new(wakes, end)),
            queues: Arc::new(Queues {
                submits: Mutex::new(()),
                new: ArrayQueue::new(GROUPS),
                over: ArrayQueue::new(2 * GROUPS),
                pairs: Arc::new(PairQueues::new()),
            }),
        }
    }

    /// Where pairs of axes that one bus thread steps are handed over.
    pub(super) fn pairs(&self) -> &Arc<PairQueues> {
        &self.queues.pairs
    }

    /// The bus thread's end. There is to be one.
    #[must_use]
    pub fn groups(&self) -> Groups {
        Groups {
            signals: Arc::clone(&self.signals),
            queues: Arc::clone(&self.queues),
            waiting: Vec::with_capacity(GROUPS),
            pairs: PairWatches::new(),
        }
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
    pairs: PairWatches,
    pub(super) signals: Arc<NetworkSignals>,
}

impl Groups {
    /// Starts the groups of which every move has what it needs, and gives up those of which one has failed. Then it looks after the pairs.
    ///
    /// To be called after [`AxisPort::before_send`](super::AxisPort::before_send) of every axis and right before
    /// sending: then no stop can come between the rise of one bit 4 and another.
    pub fn advance(&mut self, now: Duration, axes: &mut impl AxisSet) {
        self.signals.note_time(now);
        self.advance_groups(now, axes);
        self.pairs.watch(&self.queues.pairs, now, axes);
    }

    /// What was said of a pair's skew, the oldest first: once when it gets beyond a limit.
    pub fn next_skew_report(&mut self) -> Option<SkewReport> {
        self.pairs.next_report()
    }

    fn advance_groups(&mut self, now: Duration, axes: &mut impl AxisSet) {
        // In most cycles there is no group: to see that takes less than to ask the queue for one.
        while self.waiting.len() < GROUPS
            && !self.queues.new.is_empty()
            && let Some(group) = self.queues.new.pop()
        {
            self.waiting.push(group);
        }
        if self.waiting.is_empty() {
            return;
        }
        let mut place = 0;
        while let Some(group) = self.waiting.get(place) {
            if group.advance(now, axes) {
                // Moved and not cloned, so that the program drops it last. Where there is no room it is freed here.
                let _ = self.queues.over.push(self.waiting.remove(place));
            } else {
                place += 1;
            }
        }
    }
}

impl Group {
    /// Whether there is nothing more to do for it.
    fn advance(&self, now: Duration, axes: &mut impl AxisSet) -> bool {
        let is_done = |member: &GroupMember| member.request.is_done();
        // Its axis is nobody's, or another's, once its lease was given back.
        let is_over = |member: &GroupMember| {
            is_done(member) || member.shared.check_lease(member.lease).is_err()
        };
        if self.members.iter().any(is_over) {
            self.withdraw(now, axes);
            // One that was asked for when this cycle had looked at its axis is not taken yet.
            return self.members.iter().all(is_done);
        }
        let mut is_armed = |member: &GroupMember| {
            axes.axis(member.axis)
                .is_some_and(|(core, _)| core.is_armed(member.request.id))
        };
        if !self.members.iter().all(&mut is_armed) {
            return false;
        }
        for member in &self.members {
            if let Some((core, outputs)) = axes.axis(member.axis) {
                core.fire(now, member.request.id, outputs);
            }
        }
        self.fired.store(true, Ordering::Release);
        true
    }

    fn withdraw(&self, now: Duration, axes: &mut impl AxisSet) {
        for member in &self.members {
            if let Some((core, outputs)) = axes.axis(member.axis) {
                core.withdraw(now, member.request.id, outputs);
                // Its port passes on what the core reports of that, in the next cycle.
                member.shared.ask();
            }
        }
    }
}

/// Moves that start together: an array or a `Vec` of moves in one unit, a tuple of moves in any.
///
/// Sealed: no other type can be one.
pub trait StartTogether: sealed::Requests {}

impl<T: sealed::Requests> StartTogether for T {}

mod sealed {
    use super::{AxisError, AxisErrorKind, AxisUnit, CountsRequest, Move, MoveRequest, Pending};

    /// What [`start_together`](crate::start_together) asks of its moves.
    pub trait Requests {
        /// The same moves under way.
        type Moves;

        #[expect(private_interfaces, reason = "the trait is sealed")]
        fn in_counts(&self) -> Vec<CountsRequest>;

        /// In the same order.
        #[expect(private_interfaces, reason = "the trait is sealed")]
        fn under_way(self, pending: Vec<Pending>) -> Result<Self::Moves, AxisError>;
    }

    impl<U: AxisUnit> Requests for Vec<MoveRequest<U>> {
        type Moves = Vec<Move<U>>;

        #[expect(private_interfaces, reason = "the trait is sealed")]
        fn in_counts(&self) -> Vec<CountsRequest> {
            self.iter().map(MoveRequest::in_counts).collect()
        }

        #[expect(private_interfaces, reason = "the trait is sealed")]
        fn under_way(self, pending: Vec<Pending>) -> Result<Self::Moves, AxisError> {
            let moves = self.into_iter().zip(pending);
            let moves = moves.map(|(request, pending)| Move::new(pending, request.command));
            Ok(moves.collect())
        }
    }

    impl<U: AxisUnit, const N: usize> Requests for [MoveRequest<U>; N] {
        type Moves = Vec<Move<U>>;

        #[expect(private_interfaces, reason = "the trait is sealed")]
        fn in_counts(&self) -> Vec<CountsRequest> {
            self.iter().map(MoveRequest::in_counts).collect()
        }

        #[expect(private_interfaces, reason = "the trait is sealed")]
        fn under_way(self, pending: Vec<Pending>) -> Result<Self::Moves, AxisError> {
            Vec::from(self).under_way(pending)
        }
    }

    macro_rules! tuple {
        ($($unit:ident $field:tt)+) => {
            impl<$($unit: AxisUnit),+> Requests for ($(MoveRequest<$unit>,)+) {
                type Moves = ($(Move<$unit>,)+);

                #[expect(private_interfaces, reason = "the trait is sealed")]
                fn in_counts(&self) -> Vec<CountsRequest> {
                    vec![$(self.$field.in_counts()),+]
                }

                #[expect(private_interfaces, reason = "the trait is sealed")]
                fn under_way(self, pending: Vec<Pending>) -> Result<Self::Moves, AxisError> {
                    // There are as many as there are moves.
                    let none = || self.0.axis.handles.shared.error(AxisErrorKind::Closed);
                    let mut pending = pending.into_iter();
                    Ok(($(Move::new(pending.next().ok_or_else(none)?, self.$field.command),)+))
                }
            }
        };
    }

    tuple!(A 0 B 1);
    tuple!(A 0 B 1 C 2);
    tuple!(A 0 B 1 C 2 D 3);
    tuple!(A 0 B 1 C 2 D 3 E 4);
    tuple!(A 0 B 1 C 2 D 3 E 4 F 5);
}

/// Starts moves of several axes of one network in one cycle (and one frame, where their drives share it): every bit 4 rises, or none
/// does. Resolves when all drives have acknowledged. Of no moves it does nothing, and is no error.
///
/// Dropped before the bits rose, nothing is started. Nor is it where the lease of one of the moves was given back before that.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{AxisConfig, DriveConfig, Network, drives, link::Wire};
/// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// use servocrab::{SetPoint, start_together, units::{Degree, Mm, Ratio, Scale}};
/// # let drive = DriveConfig::new(drives::akd2g())
/// #     .axis(AxisConfig::new("x").unit::<Mm>(Scale::counts_per_unit(Ratio::new(1000, 1)?))).axis(AxisConfig::new("turret").unit::<Degree>(Scale::counts_per_unit(Ratio::new(3600, 360)?)));
/// # smol::block_on(async {
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// let (x, turret) = (net.axis_in::<Mm>("x")?, net.axis_in::<Degree>("turret")?);
/// x.enable().await?;
/// turret.enable().await?;
/// let (on_x, on_turret) = (x.profile_position().await?, turret.profile_position().await?);
/// // Moves in different units are a tuple; those in one may be an array or a `Vec`.
/// let (there, round) = start_together((
///     on_x.rel(2.5, SetPoint::new().velocity(50.0)),
///     on_turret.rel(90.0, SetPoint::new().velocity(720.0)),
/// )).await?;
/// println!("{} mm", there.done().await?.position());
/// // Within the position window, here ten counts.
/// assert!((round.done().await?.position() - 90.0).abs() <= 1.0);
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
///
/// # Errors
/// The first reason. [`AxisErrorKind::NotAllStarted`] where the bits had risen: then the error names the axes whose drives have
/// acknowledged their moves, which are under way. A drive that has not acknowledged may have begun its own: stop every axis of the group.
/// By any other error no bit 4 has risen.
pub async fn start_together<R: StartTogether>(requests: R) -> Result<R::Moves, AxisError> {
    let pending = start(&requests.in_counts()).await?;
    requests.under_way(pending)
}

/// Gives what is under way in the order of the requests.
async fn start(requests: &[CountsRequest]) -> Result<Vec<Pending>, AxisError> {
    let Some(first) = requests.first() else {
        return Ok(Vec::new());
    };
    let shared_of = |request: &CountsRequest| Arc::clone(&request.handles.shared);
    let queues = &shared_of(first).setup.groups.queues;
    while queues.over.pop().is_some() {}
    for (n, request) in requests.iter().enumerate() {
        let shared = shared_of(request);
        let twice = requests
            .iter()
            .take(n)
            .any(|other| Arc::ptr_eq(&shared_of(other), &shared));
        if twice || !Arc::ptr_eq(&shared.setup.groups.queues, queues) {
            return Err(shared.error(AxisErrorKind::NotTogether));
        }
    }

    // In the order of the axes, so that two groups never wait for each other's parameters.
    let mut in_order: Vec<&CountsRequest> = requests.iter().collect();
    in_order.sort_by_key(|request| request.handles.shared.setup.index);
    // A stop that comes while parameters are being written stops these moves as well.
    let asked: Vec<_> = in_order.iter().map(|request| request.last_stop()).collect();
    let splits = split(&in_order).await?;
    let mut prepared = Vec::new();
    let mut claims = Vec::new();
    for ((request, split), asked) in in_order.into_iter().zip(splits).zip(asked) {
        let (command, claim) = request.write(split, asked).await?;
        prepared.push((request, command, asked));
        claims.push(claim);
    }
    let (group, pending) = submit(queues, &prepared)?;
    // Only here: it wakes those who wait, and a waker may do what it likes, such as asking for a group.
    for (claim, pending) in claims.into_iter().zip(&pending) {
        if let Some(claim) = claim {
            claim.sent(pending);
        }
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
    if errors.is_empty() {
        return Ok(started.into_iter().map(|(_, accepted)| accepted).collect());
    }
    // The one that failed by itself says more than those that were withdrawn for it.
    let own = errors
        .iter()
        .position(|error| error.failure() != Some(Failure::Withdrawn));
    if own.is_none() {
        // A lease was given back, which none of them can say.
        requests.iter().try_for_each(CountsRequest::check_lease)?;
    }
    let error = errors.swap_remove(own.unwrap_or(0));
    if !group.fired.load(Ordering::Acquire) {
        return Err(error);
    }
    let started = started.iter();
    let started = started.map(|(request, _)| request.handles.shared.identity.axis.clone());
    Err(error.of_not_all_started(started.collect()))
}

/// Splits the moves of a group. Where one of them writes by SDO all are checked: one that is refused leaves the parameters of the others
/// as they are.
async fn split(requests: &[&CountsRequest]) -> Result<Vec<SplitMove>, AxisError> {
    let splits = requests.iter().map(|request| request.split());
    let mut splits = splits.collect::<Result<Vec<_>, _>>()?;
    let both = || requests.iter().zip(&splits);
    if both().any(|(request, split)| request.has_to_write(split)) {
        // All in one cycle.
        let checks = both().map(|(request, split)| request.submit_check(split.asked));
        for check in checks.collect::<Result<Vec<_>, _>>()? {
            check.done().await?;
        }
        splits.iter_mut().for_each(|split| split.checked = true);
    }
    Ok(splits)
}

/// Submits the moves of a group, and then the group.
fn submit(
    queues: &Queues,
    prepared: &[(&CountsRequest, MoveCommand, LastStop)],
) -> Result<(Arc<Group>, Vec<Pending>), AxisError> {
    let _in_turn = queues
        .submits
        .lock()
        .unwrap_or_else(PoisonError::into_inner);
    // Dropped on the way out, what was submitted is withdrawn.
    let mut pending: Vec<Pending> = Vec::new();
    let mut members = Vec::new();
    for (request, command, asked) in prepared {
        let command = MoveCommand {
            gated: true,
            ..*command
        };
        let submitted = request.submit(command, *asked)?;
        let shared = &request.handles.shared;
        members.push(GroupMember {
            axis: shared.setup.index,
            request: Arc::clone(&submitted.request),
            lease: request.lease,
            shared: Arc::clone(shared),
        });
        pending.push(submitted);
    }
    let group = Arc::new(Group {
        members,
        fired: AtomicBool::new(false),
    });
    match (queues.new.push(Arc::clone(&group)), prepared.first()) {
        (Err(_), Some((first, ..))) => Err(first.handles.shared.error(AxisErrorKind::QueueFull)),
        _ => Ok((group, pending)),
    }
}
