//! Two axes that carry one thing, such as the sides of a gantry: enabled, started and stopped together.
//!
//! The bus thread looks after them in each cycle, right before sending (`PairWatches`): where one is stopped, fails or runs away from the
//! other, the stop of both is in that frame. The handle holds the leases of both, so that nobody else moves one alone.

use core::{
    fmt,
    future::Future,
    sync::atomic::{AtomicBool, AtomicU64, Ordering},
    time::Duration,
};
use std::sync::Arc;

use crossbeam_queue::ArrayQueue;
use smol::future::zip;

use crate::{
    Failure, HomingParameters, SetPoint, StopRequest,
    axis::{AxisCore, Command, Delivery, Snapshot},
    ds402::Mode,
    profile_position::VelocityOverride,
    units::{AxisUnit, Counts, Scale},
};

use super::{
    Axis, AxisError, AxisErrorKind, AxisIdentity, AxisSet, Move, MoveRequest, Outcome,
    ProfilePosition, StopHandle,
    axis::Lease,
    homing::home_together,
    shared::Shared,
    start_together::start_together,
    stops::{LastStop, StopKind},
};

/// Pairs of one network.
const PAIRS: usize = 16;
/// A resume of both is asked for so often until one cycle takes both.
const RESUMES: usize = 8;

/// Why two axes cannot be a pair, or their pair cannot go on. Lengths are in the unit of the axes.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PairError {
    /// It is one axis, or they are of two networks.
    #[error("a pair needs two axes of one network")]
    NotTwo,
    /// Positions of a modulo axis begin again, so there is no skew.
    #[error("a modulo axis cannot be one of a pair")]
    Modulo,
    /// There are as many pairs as there can be.
    #[error("the network has {PAIRS} pairs already: drop one of them")]
    TooMany,
    /// The limits are not positive, or the pair would be stopped before it is warned of.
    #[error("the skew is warned of at {warn} and stopped at {stop}: expected 0 < warn < stop")]
    Limits {
        /// Where it is warned of.
        warn: f64,
        /// Where both are stopped.
        stop: f64,
    },
    /// A limit of the skew in a squaring is not a positive number.
    #[error("the limit of the skew in a squaring is {0}: expected a positive number")]
    SquaringLimit(f64),
    /// One axis of the pair was to be moved alone: nothing was sent. Use the pair, or drop it.
    #[error("this axis is one of a pair: move the pair, or drop it first")]
    Paired,
    /// The skew is, or was, beyond its limit: both were stopped, or nothing was sent.
    #[error(
        "the skew is {skew} {unit}, beyond {limit} {unit}: look for what holds one of them back, then square the pair"
    )]
    Skew {
        /// The position of the first axis less that of the second.
        skew: f64,
        /// The limit.
        limit: f64,
        /// The unit of both.
        unit: &'static str,
    },
    /// A squaring was not completed, or a drive without an absolute encoder was without power, so it is not known where the axes are square.
    /// Nothing was sent.
    #[error(
        "the pair is not square: a squaring was not completed, or a drive has lost its position; square it again"
    )]
    NotSquare,
    /// A move until a torque holds one axis while the other goes on. Nothing was sent.
    #[error("a pair cannot move until a torque")]
    UntilTorque,
}

/// The skew of a pair has got beyond one of its limits.
#[derive(Debug, Clone, PartialEq)]
pub struct SkewReport {
    /// The axes of the pair.
    pub axes: [Arc<AxisIdentity>; 2],
    /// The position of the first less that of the second, from where they are square.
    pub skew: f64,
    /// The limit.
    pub limit: f64,
    /// The unit of both.
    pub unit: &'static str,
    /// Whether both are stopped. Else this is the warning.
    pub stopped: bool,
}

impl fmt::Display for SkewReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            axes: [one, other],
            skew,
            limit,
            unit,
            stopped,
        } = self;
        let done = if *stopped { ": both are stopped" } else { "" };
        write!(
            f,
            "the skew of axes {} and {} is {skew} {unit}, beyond {limit} {unit}{done}",
            one.axis, other.axis
        )
    }
}

/// What a pair shares with the bus thread. Lengths are in the unit of both axes.
#[derive(Debug)]
struct PairShared {
    axes: [PairedAxis; 2],
    unit: &'static str,
    warn: f64,
    stop: f64,
    /// By how much the first is ahead where they are square. NaN where that is not known.
    zero: Length,
    /// The skew in the last cycle that showed both, without a squaring; NaN where there is none.
    skew: Length,
    /// The limit of the squaring that is under way; NaN where none is.
    squaring: Length,
    /// The skew for which both were stopped; NaN where they were not since the last start.
    exceeded: Length,
    /// The pair is gone.
    over: AtomicBool,
}

impl PairShared {
    fn last_stops(&self) -> [LastStop; 2] {
        self.axes.each_ref().map(|axis| axis.shared.stops.last())
    }
}

#[derive(Debug)]
struct PairedAxis {
    shared: Arc<Shared>,
    scale: Scale,
}

impl PairedAxis {
    fn is_at(&self, position: i32) -> f64 {
        self.scale.position_of(position)
    }
}

/// A length that two threads share.
#[derive(Debug)]
struct Length(AtomicU64);

impl Length {
    const fn new(length: f64) -> Self {
        Self(AtomicU64::new(length.to_bits()))
    }

    fn get(&self) -> f64 {
        f64::from_bits(self.0.load(Ordering::Acquire))
    }

    fn set(&self, length: f64) {
        self.0.store(length.to_bits(), Ordering::Release);
    }
}

// The bus thread's side.

/// How pairs come to the bus thread, and back.
#[derive(Debug)]
pub(super) struct PairQueues {
    new: ArrayQueue<Arc<PairShared>>,
    /// So that the bus thread frees no memory.
    over: ArrayQueue<Arc<PairShared>>,
}

impl PairQueues {
    pub fn new() -> Self {
        Self {
            new: ArrayQueue::new(PAIRS),
            over: ArrayQueue::new(2 * PAIRS),
        }
    }
}

/// The pairs of a network, watched in each cycle.
#[derive(Debug)]
pub(super) struct PairWatches {
    watched: Vec<PairWatch>,
    reports: ArrayQueue<SkewReport>,
}

#[derive(Debug)]
struct PairWatch {
    pair: Arc<PairShared>,
    is_warned: bool,
    squaring: Option<Squaring>,
    /// The last stop of each that both have.
    stops: [LastStop; 2],
}

/// How far each axis has come in a squaring, in which each drive sets its position.
#[derive(Debug)]
struct Squaring {
    limit: f64,
    last: [f64; 2],
    way: [f64; 2],
}

impl PairWatches {
    pub fn new() -> Self {
        Self {
            watched: Vec::with_capacity(PAIRS),
            reports: ArrayQueue::new(2 * PAIRS),
        }
    }

    pub fn next_report(&self) -> Option<SkewReport> {
        self.reports.pop()
    }

    /// Stops both axes of a pair of which one is stopped, has failed, or has run away from the other.
    pub fn watch(&mut self, queues: &PairQueues, now: Duration, axes: &mut impl AxisSet) {
        while self.watched.len() < PAIRS
            && !queues.new.is_empty()
            && let Some(pair) = queues.new.pop()
        {
            self.watched.push(PairWatch {
                stops: pair.last_stops(),
                pair,
                is_warned: false,
                squaring: None,
            });
        }
        let mut place = 0;
        while let Some(watch) = self.watched.get_mut(place) {
            if let Some(report) = watch.watch(now, axes) {
                // What nobody takes is lost.
                let _ = self.reports.push(report);
            }
            if watch.is_over(axes) {
                // Moved and not cloned, so that the program drops it last.
                let _ = queues.over.push(self.watched.swap_remove(place).pair);
            } else {
                place += 1;
            }
        }
    }
}

impl PairWatch {
    /// Gone, and at rest.
    fn is_over(&self, axes: &mut impl AxisSet) -> bool {
        self.pair.over.load(Ordering::Acquire)
            && self
                .read(axes, moves)
                .is_none_or(|moves| moves == [false; 2])
    }

    fn read<T>(&self, axes: &mut impl AxisSet, of: impl Fn(&AxisCore) -> T) -> Option<[T; 2]> {
        let [one, other] = &self.pair.axes;
        let mut of_axis = |axis: &PairedAxis| {
            let (core, _) = axes.axis(axis.shared.setup.index)?;
            Some(of(core))
        };
        Some([of_axis(one)?, of_axis(other)?])
    }

    fn watch(&mut self, now: Duration, axes: &mut impl AxisSet) -> Option<SkewReport> {
        let positions = self.read(axes, fresh_position)?;
        for axis in &self.pair.axes {
            if axis.shared.displaced.swap(false, Ordering::AcqRel) {
                self.pair.zero.set(f64::NAN);
            }
        }
        let is_moving = self.read(axes, moves)?.contains(&true);
        let skew = self.skew(positions);
        let limit = self
            .squaring
            .as_ref()
            .map_or(self.pair.stop, |squaring| squaring.limit);
        let report = skew.and_then(|skew| self.judge(skew, limit, is_moving));
        let asked = self.asked();
        if !is_moving && asked == [StopRequest::empty(); 2] {
            return report;
        }
        let mut stop = strongest(asked);
        if is_moving {
            let of_cores = self.read(axes, |core| core.stops()[1])?;
            stop = strongest([stop, strongest(of_cores)]);
            if skew.is_some_and(|skew| skew.abs() > limit) {
                stop = StopRequest::QUICK_STOP;
            }
        }
        for (place, axis) in self.pair.axes.iter().enumerate() {
            let (core, outputs) = axes.axis(axis.shared.setup.index)?;
            let [under_way, _] = core.stops();
            // What has nothing to move may be about to begin.
            let is_new = asked[1 - place].bits() > asked[place].bits();
            let stops =
                under_way.bits() < stop.bits() && (is_new || moves(core)) && core.takes_stops();
            // What was asked for before does not begin after it. A halt that is no new one is not asked for.
            if is_new || (stops && stop != StopRequest::HALT) {
                let kind = StopKind::of_request(stop);
                self.stops[place] = axis.shared.stops.note(kind);
            }
            if stops {
                core.apply_stop(now, stop, outputs);
            }
        }
        report
    }

    /// What has stopped each since the last look. An axis that has arrived shows nothing of its stop, while the other one may move on.
    fn asked(&mut self) -> [StopRequest; 2] {
        let before = core::mem::replace(&mut self.stops, self.pair.last_stops());
        [0, 1].map(|n: usize| match self.stops[n] {
            last if last == before[n] => StopRequest::empty(),
            last if last.is(StopKind::Halt) => StopRequest::HALT,
            _ => StopRequest::STOP,
        })
    }

    /// The skew, where both axes have answered.
    fn skew(&mut self, positions: [Option<i32>; 2]) -> Option<f64> {
        let [Some(one), Some(other)] = positions else {
            return None;
        };
        let [first, second] = &self.pair.axes;
        let at = [first.is_at(one), second.is_at(other)];
        let limit = self.pair.squaring.get();
        if limit.is_nan() {
            self.squaring = None;
            let skew = readable(at[0] - at[1] - self.pair.zero.get());
            self.pair.skew.set(skew);
            return Some(skew);
        }
        let begin = || Squaring {
            limit,
            last: at,
            way: [0.0; 2],
        };
        Some(self.squaring.get_or_insert_with(begin).follow(at))
    }

    /// What is to be said of this skew.
    fn judge(&mut self, skew: f64, limit: f64, is_moving: bool) -> Option<SkewReport> {
        let pair = &self.pair;
        let (size, warn) = (skew.abs(), pair.warn);
        let report = |limit, stopped| {
            Some(SkewReport {
                axes: [0, 1].map(|n: usize| Arc::clone(&pair.axes[n].shared.identity)),
                skew,
                limit,
                unit: pair.unit,
                stopped,
            })
        };
        if size > limit && is_moving && pair.exceeded.get().is_nan() {
            pair.exceeded.set(skew);
            self.is_warned = true;
            return report(limit, true);
        }
        if size <= warn / 2.0 {
            self.is_warned = false;
        }
        if size > warn && !self.is_warned && self.squaring.is_none() {
            self.is_warned = true;
            return report(warn, false);
        }
        None
    }
}

const fn strongest([one, other]: [StopRequest; 2]) -> StopRequest {
    if one.bits() > other.bits() {
        one
    } else {
        other
    }
}

/// Whether its drive has something that moves it, or may have.
fn moves(core: &AxisCore) -> bool {
    core.snapshot().has_set_point
}

/// 6064h, where it came in with the last cycle.
fn fresh_position(core: &AxisCore) -> Option<i32> {
    let snapshot = core.snapshot();
    (snapshot.answered && !snapshot.lost).then_some(snapshot.position)
}

impl Squaring {
    /// The difference of the two ways. A step of one cycle beyond the limit is no way: the drive has set its position.
    fn follow(&mut self, at: [f64; 2]) -> f64 {
        for ((at, last), way) in at.iter().zip(&mut self.last).zip(&mut self.way) {
            let step = at - *last;
            if step.abs() <= self.limit {
                *way += step;
            }
            *last = *at;
        }
        let [one, other] = self.way;
        readable(one - other)
    }
}

/// Without the digits that only a sum of fractions has.
fn readable(length: f64) -> f64 {
    (length * 1e6).round() / 1e6
}

// The program's side.

impl<U: AxisUnit> Axis<U> {
    /// Makes a pair of this axis and another one in the same unit, once [`Pairing::skew`] gives its limits.
    ///
    /// Both handles are taken. Others of these axes still stop them, and both stop then; what would move one alone is refused as
    /// [`PairError::Paired`] for as long as there is the pair.
    pub const fn pair_with(self, other: Self) -> Pairing<U> {
        Pairing([self, other])
    }
}

/// Two axes that become a pair as soon as their limits are given.
#[must_use = "`skew` makes the pair"]
#[derive(Debug)]
pub struct Pairing<U: AxisUnit = Counts>([Axis<U>; 2]);

impl<U: AxisUnit> Pairing<U> {
    /// The pair, as square as it stands now. The skew is what the position of the first is ahead of that of the second (6064h), from
    /// where they stand now or were squared. Beyond `warn` there is an event ([`NetworkEvent::Skew`](crate::bus::NetworkEvent::Skew)).
    /// Beyond `stop` both are stopped by quick stop, in the next frame. An override of either ([`Axis::set_override`]) is gone.
    ///
    /// # Errors
    /// [`AxisErrorKind::Pair`] with [`PairError::Limits`], [`PairError::NotTwo`], [`PairError::Modulo`] or [`PairError::TooMany`].
    /// [`AxisErrorKind::ModeInUse`] while a mode of one of them is leased, [`PairError::Paired`] where one is in a pair.
    /// [`Failure::Moving`] while one of them has a set-point, [`Failure::BusLost`] where one is lost.
    pub fn skew(self, warn: U::Signed, stop: U::Signed) -> Result<Pair<U>, AxisError> {
        let [one, other] = self.0;
        let shared = [&one, &other].map(|axis| Arc::clone(&axis.handles.shared));
        let refused = |error| shared[0].error(AxisErrorKind::Pair(Box::new(error)));
        let (warn, stop): (f64, f64) = (warn.into(), stop.into());
        if !(warn > 0.0 && warn < stop && stop.is_finite()) {
            return Err(refused(PairError::Limits { warn, stop }));
        }
        let groups = &shared[0].setup.groups;
        if Arc::ptr_eq(&shared[0], &shared[1])
            || !Arc::ptr_eq(groups.pairs(), shared[1].setup.groups.pairs())
        {
            return Err(refused(PairError::NotTwo));
        }
        let turns = shared.iter().any(|of| of.notes.settings().turn.is_some());
        if turns {
            return Err(refused(PairError::Modulo));
        }
        let leases = [Lease::take(&one.handles)?, Lease::take(&other.handles)?];
        if let Some(moving) = shared.iter().find(|of| of.snapshot().has_set_point) {
            return Err(moving.error(AxisErrorKind::Failed(Failure::Moving)));
        }
        if let Some(lost) = shared.iter().find(|of| of.snapshot().lost) {
            let delivery = Delivery::NotSent;
            return Err(lost.error(AxisErrorKind::Failed(Failure::BusLost { delivery })));
        }
        for shared in &shared {
            shared.displaced.store(false, Ordering::Release);
        }
        // Two factors would be two speeds.
        for axis in [&one, &other] {
            axis.submit(Command::SetOverride(VelocityOverride::NONE))?;
        }
        let stands = [&one, &other].map(|axis| Into::<f64>::into(axis.status().position));
        let queues = groups.pairs();
        while queues.over.pop().is_some() {}
        let paired = Arc::new(PairShared {
            axes: [&one, &other].map(|axis| PairedAxis {
                shared: Arc::clone(&axis.handles.shared),
                scale: axis.unit.scale,
            }),
            unit: U::NAME,
            warn,
            stop,
            zero: Length::new(stands[0] - stands[1]),
            skew: Length::new(f64::NAN),
            squaring: Length::new(f64::NAN),
            exceeded: Length::new(f64::NAN),
            over: AtomicBool::new(false),
        });
        if queues.new.push(Arc::clone(&paired)).is_err() {
            return Err(refused(PairError::TooMany));
        }
        for shared in &shared {
            shared.paired.store(true, Ordering::Release);
        }
        let [lease, other_lease] = leases.map(Arc::new);
        Ok(Pair(Arc::new(Both {
            paired,
            is_starting: AtomicBool::new(false),
            axes: [
                ProfilePosition::new(one, Arc::clone(&lease)),
                ProfilePosition::new(other, Arc::clone(&other_lease)),
            ],
            leases: [lease, other_lease],
        })))
    }
}

/// Two axes that carry one thing, such as the sides of a gantry, in Profile Position: from [`Network::pair`](crate::Network::pair).
///
/// Both are enabled, started and stopped together. Where one is stopped by anyone, has a fault, is lost, or runs away from the other,
/// the stop of both is in the next frame. Each drive runs a profile of its own, so nothing couples the two: the skew is watched, not
/// controlled.
///
/// When it and its [`PairMove`]s are dropped, moving axes are stopped.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{AxisConfig, DriveConfig, Network, Referencing, drives, link::Wire};
/// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// # let axis = |name| AxisConfig::new(name).referencing(Referencing::AbsoluteEncoder);
/// # let drive = DriveConfig::new(drives::akd2g()).axis(axis("x1")).axis(axis("x2"));
/// # smol::block_on(async {
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// use servocrab::SetPoint;
/// let gantry = net.pair("x1", "x2")?.skew(500, 2_000)?;
/// gantry.enable().await?;
/// let there = gantry.move_abs(20_000, SetPoint::new().velocity(100_000)).await?;
/// let [one, other] = there.done().await?;
/// println!("{one}, {other}; skew {}", gantry.skew());
/// gantry.disable().await?;
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
#[derive(Debug)]
pub struct Pair<U: AxisUnit = Counts>(Arc<Both<U>>);

/// The pair, and its moves.
#[derive(Debug)]
struct Both<U: AxisUnit> {
    paired: Arc<PairShared>,
    /// Whether a motion was asked for that may be sent, and that no snapshot shows yet.
    is_starting: AtomicBool,
    axes: [ProfilePosition<U>; 2],
    leases: [Arc<Lease>; 2],
}

impl<U: AxisUnit> Pair<U> {
    /// Both to Operation enabled. Where one is not, both are disabled.
    ///
    /// # Errors
    /// As [`Axis::enable`], of the first that fails.
    pub async fn enable(&self) -> Result<(), AxisError> {
        let enabled = self.on_both(Axis::enable).await;
        if enabled.is_err() {
            // The reason is that of the enable.
            let _ = self.disable().await;
        }
        enabled
    }

    /// Both off power; moving ones are stopped before.
    ///
    /// # Errors
    /// As [`Axis::disable`].
    pub async fn disable(&self) -> Result<(), AxisError> {
        self.on_both(Axis::disable).await
    }

    /// Both out of Fault; it enables none.
    ///
    /// # Errors
    /// As [`Axis::reset_fault`].
    pub async fn reset_fault(&self) -> Result<(), AxisError> {
        self.on_both(Axis::reset_fault).await
    }

    /// Pauses both by bit 8; resolves when both stand.
    ///
    /// # Errors
    /// As [`Axis::halt`].
    pub async fn halt(&self) -> Result<(), AxisError> {
        self.on_both(Axis::halt).await
    }

    /// Both go on after a halt, in one frame.
    ///
    /// # Errors
    /// As [`Axis::resume`]. Where one cannot, none goes on.
    pub async fn resume(&self) -> Result<(), AxisError> {
        self.check_square()?;
        let asked = self.last_stops();
        for _ in 1..RESUMES {
            let resumed = self.on_both(|axis| async { axis.run(Command::Resume).await.map(drop) });
            match resumed.await {
                // One cycle took one of them alone, and so none.
                Err(error) if is_halted(&error) && self.last_stops() == asked => {}
                result => return result,
            }
        }
        self.on_both(|axis| async { axis.run(Command::Resume).await.map(drop) })
            .await
    }

    /// Halts both, then abandons their set-points by quick stop.
    ///
    /// # Errors
    /// As [`Axis::stop`].
    pub async fn stop(&self) -> Result<(), AxisError> {
        self.on_both(|axis| async { axis.stop().await.map(drop) })
            .await
    }

    /// Quick stop of both (bit 2).
    ///
    /// # Errors
    /// As [`Axis::quick_stop`].
    pub async fn quick_stop(&self) -> Result<(), AxisError> {
        self.on_both(|axis| async { axis.quick_stop().await.map(drop) })
            .await
    }

    /// What stops both from anywhere: a stop of one is that of the other.
    #[must_use]
    pub fn stop_handle(&self) -> StopHandle {
        self.axes()[0].stop_handle()
    }

    /// Both to this position of the first axis: the second goes to where the pair is square then. Resolves when both drives have
    /// acknowledged. Dropped before the bits 4 rose, nothing is started.
    ///
    /// # Errors
    /// As [`ProfilePosition::move_abs`], of the axis that the error names. [`AxisErrorKind::Pair`] with [`PairError::Skew`],
    /// [`PairError::NotSquare`] or [`PairError::UntilTorque`]. After an error both stand or are stopped.
    pub async fn move_abs(
        &self,
        target: U::Signed,
        set_point: SetPoint<U>,
    ) -> Result<PairMove<U>, AxisError> {
        let beside: f64 = target.into() - self.0.paired.zero.get();
        let beside = U::signed(beside.round() as i32, beside);
        let [one, other] = &self.0.axes;
        self.start([one.abs(target, set_point), other.abs(beside, set_point)])
            .await
    }

    /// Both by this distance, each from the base that its drive documents; otherwise as [`move_abs`](Self::move_abs). What each drive
    /// counts from, and rounds, differs: many distances add up to a skew.
    ///
    /// # Errors
    /// As [`move_abs`](Self::move_abs).
    pub async fn move_rel(
        &self,
        distance: U::Signed,
        set_point: SetPoint<U>,
    ) -> Result<PairMove<U>, AxisError> {
        let [one, other] = &self.0.axes;
        self.start([one.rel(distance, set_point), other.rel(distance, set_point)])
            .await
    }

    /// Squares the pair: both axes are homed at once, each to its own switch. From then on they are square where both positions are equal,
    /// so that the home offsets say where the switches are. Gives the skew in which they stand: a move to one position ends it.
    ///
    /// Until both are home, their ways since the start may differ by `limit`: beyond it both are stopped. In a cycle in which a position
    /// changes by more than that, it counts as set by its drive. Dropped, it stops both.
    ///
    /// # Errors
    /// As [`Homing::home`](crate::Homing::home), and [`AxisErrorKind::Pair`] with [`PairError::Skew`] or [`PairError::SquaringLimit`]. After an error from when
    /// the homings began the pair is [`PairError::NotSquare`].
    pub async fn square(
        &self,
        homings: [HomingParameters<U>; 2],
        limit: U::Signed,
    ) -> Result<U::Signed, AxisError> {
        let limit: f64 = limit.into();
        if !(limit > 0.0 && limit.is_finite()) {
            return Err(self.refused(PairError::SquaringLimit(limit)));
        }
        self.select(Mode::Homing).await?;
        let begin = || {
            self.begin();
            SquaringGuard::begin(&self.0.paired, limit)
        };
        let (squaring, [one, other]) =
            home_together(self.axes(), &self.0.leases, homings, begin).await?;
        let homed = both(one, other);
        homed.map_err(|error| self.0.reason(error))?;
        squaring.end();
        self.0.is_starting.store(false, Ordering::Release);
        let [one, other]: [f64; 2] = self.status().map(|status| status.position.into());
        let skew = readable(one - other);
        Ok(U::signed(skew as i32, skew))
    }

    /// How far the first axis is ahead of the second, from where they are square, in the last cycle that showed both. 0 where the pair is
    /// not square.
    #[must_use]
    pub fn skew(&self) -> U::Signed {
        let skew = self.0.paired.skew.get();
        let skew = if skew.is_nan() { 0.0 } else { skew };
        U::signed(skew as i32, skew)
    }

    /// The latest snapshots of both.
    #[must_use]
    pub fn status(&self) -> [Snapshot<U>; 2] {
        self.axes().map(Axis::status)
    }

    fn axes(&self) -> [&Axis<U>; 2] {
        self.0.axes.each_ref().map(ProfilePosition::axis)
    }

    fn last_stops(&self) -> [LastStop; 2] {
        self.0.paired.last_stops()
    }

    fn refused(&self, error: PairError) -> AxisError {
        let shared = &self.axes()[0].handles.shared;
        shared.error(AxisErrorKind::Pair(Box::new(error)))
    }

    /// A motion begins: what has stopped an earlier one is not its error.
    fn begin(&self) {
        self.0.paired.exceeded.set(f64::NAN);
        self.0.is_starting.store(true, Ordering::Release);
    }

    /// That nothing is in the way of a motion of both.
    fn check_square(&self) -> Result<(), AxisError> {
        let paired = &self.0.paired;
        if paired.zero.get().is_nan() {
            return Err(self.refused(PairError::NotSquare));
        }
        let skew = paired.skew.get();
        if skew.abs() > paired.stop {
            return Err(self.refused(PairError::Skew {
                skew,
                limit: paired.stop,
                unit: U::NAME,
            }));
        }
        Ok(())
    }

    async fn start(&self, requests: [MoveRequest<U>; 2]) -> Result<PairMove<U>, AxisError> {
        self.check_square()?;
        if requests
            .iter()
            .any(|of| of.command.set_point.contact.is_some())
        {
            return Err(self.refused(PairError::UntilTorque));
        }
        self.select(Mode::ProfilePosition).await?;
        self.begin();
        let started = start_together(requests).await;
        self.0.is_starting.store(false, Ordering::Release);
        let moves = started.map_err(|error| {
            if matches!(error.kind, AxisErrorKind::NotAllStarted { .. }) {
                self.0.request_stop(StopRequest::QUICK_STOP);
            }
            self.0.reason(error)
        })?;
        let moves = moves.try_into();
        let moves = moves.map_err(|_| self.refused(PairError::NotTwo))?;
        Ok(PairMove {
            moves,
            both: Arc::clone(&self.0),
        })
    }

    /// Selects a mode of both, unless both are in it.
    async fn select(&self, mode: Mode) -> Result<(), AxisError> {
        if self.axes().iter().all(|axis| axis.status().mode == mode) {
            return Ok(());
        }
        self.on_both(|axis| axis.select(mode)).await
    }

    /// Asks the same of both at once, and waits for both.
    async fn on_both<'a, F>(&'a self, ask: impl Fn(&'a Axis<U>) -> F) -> Result<(), AxisError>
    where
        F: Future<Output = Result<(), AxisError>> + 'a,
    {
        let [one, other] = self.axes();
        let (one, other) = zip(ask(one), ask(other)).await;
        both(one, other).map(drop)
    }
}

impl<U: AxisUnit> Both<U> {
    fn request_stop(&self, stop: StopRequest) {
        for axis in &self.axes {
            axis.axis().handles.shared.request_stop(stop);
        }
    }

    /// The error of a motion; the skew, where it was stopped for that and has not failed by itself.
    fn reason(&self, error: AxisError) -> AxisError {
        let skew = self.paired.exceeded.get();
        if skew.is_nan() || !is_consequence(&error) {
            return error;
        }
        let squaring = self.paired.squaring.get();
        let limit = if squaring.is_nan() {
            self.paired.stop
        } else {
            squaring
        };
        let shared = &self.axes[0].axis().handles.shared;
        let error = PairError::Skew {
            skew,
            limit,
            unit: U::NAME,
        };
        shared.error(AxisErrorKind::Pair(Box::new(error)))
    }
}

/// Both results, or the error that has made the other one.
fn both<T>(one: Result<T, AxisError>, other: Result<T, AxisError>) -> Result<[T; 2], AxisError> {
    let error = match (one, other) {
        (Ok(one), Ok(other)) => return Ok([one, other]),
        (Err(error), Ok(_)) | (Ok(_), Err(error)) => error,
        (Err(one), Err(other)) if is_consequence(&one) => other,
        (Err(one), Err(_)) => one,
    };
    Err(error)
}

/// Whether it is what a stop of the other axis makes of this one.
pub(super) fn is_consequence(error: &AxisError) -> bool {
    is_halted(error) || matches!(error.failure(), Some(Failure::QuickStopped { .. }))
}

fn is_halted(error: &AxisError) -> bool {
    matches!(error.failure(), Some(Failure::Halted { .. }))
}

impl<U: AxisUnit> Drop for Both<U> {
    fn drop(&mut self) {
        let statuses = self.axes.each_ref().map(|axis| axis.axis().status());
        let is_starting = self.is_starting.load(Ordering::Acquire);
        if is_starting || statuses.iter().any(|status| status.has_set_point) {
            self.request_stop(StopRequest::STOP);
        }
        for axis in &self.axes {
            let shared = &axis.axis().handles.shared;
            shared.paired.store(false, Ordering::Release);
        }
        self.paired.over.store(true, Ordering::Release);
    }
}

/// A squaring that is under way.
struct SquaringGuard<'a>(&'a PairShared);

impl<'a> SquaringGuard<'a> {
    fn begin(paired: &'a PairShared, limit: f64) -> Self {
        paired.zero.set(f64::NAN);
        paired.skew.set(f64::NAN);
        paired.squaring.set(limit);
        Self(paired)
    }

    /// Both are home: they are square where both positions are equal.
    fn end(self) {
        self.0.zero.set(0.0);
    }
}

impl Drop for SquaringGuard<'_> {
    fn drop(&mut self) {
        // The bus thread gives the next one once it sees the end.
        self.0.skew.set(f64::NAN);
        self.0.squaring.set(f64::NAN);
    }
}

/// A move of both axes of a [`Pair`] that both drives have acknowledged.
#[must_use = "await `done()` for the outcome"]
#[derive(Debug)]
pub struct PairMove<U: AxisUnit = Counts> {
    moves: [Move<U>; 2],
    both: Arc<Both<U>>,
}

impl<U: AxisUnit> PairMove<U> {
    /// Waits for both outcomes. A halt ends the wait, as that of [`Move::done`].
    ///
    /// # Errors
    /// Of the axis that has failed by itself; the other one was stopped. [`PairError::Skew`] where both were stopped for that, and neither
    /// has failed by itself.
    pub async fn done(&self) -> Result<[Outcome<U>; 2], AxisError> {
        let [one, other] = &self.moves;
        let (one, other) = zip(one.done(), other.done()).await;
        self.judge(one, other)
    }

    /// As [`done`](Self::done), but waits on through halts.
    ///
    /// # Errors
    /// As [`done`](Self::done).
    pub async fn done_through_halt(&self) -> Result<[Outcome<U>; 2], AxisError> {
        let [one, other] = &self.moves;
        let (one, other) = zip(one.done_through_halt(), other.done_through_halt()).await;
        self.judge(one, other)
    }

    fn judge(
        &self,
        one: Result<Outcome<U>, AxisError>,
        other: Result<Outcome<U>, AxisError>,
    ) -> Result<[Outcome<U>; 2], AxisError> {
        let outcomes = both(one, other);
        outcomes.map_err(|error| self.both.reason(error))
    }
}
