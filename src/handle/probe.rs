//! Touch probes: the drive holds the position at an edge of an input (60B8h to 60BDh), beside whatever moves the axis.
//!
//! All of it is the program's: a future looks once a cycle while somebody waits. The bus thread carries the objects, and knows of nothing.

use core::{
    fmt,
    marker::PhantomData,
    sync::atomic::{AtomicBool, AtomicU16, Ordering},
    time::Duration,
};
use std::sync::Arc;

use crate::{
    Failure,
    axis::{Delivery, Unsupported},
    coe::{Number, Object, ObjectAddress, ReadOnly, Readable, SdoError, Transfer, Value, obj},
    ds402::{State, TouchProbeFunction, TouchProbeStatus},
    pdo_map,
    profile_position::PositionRange,
    units::{AxisUnit, Counts},
};

use super::{
    Axis, AxisError, AxisErrorKind, MoveRequest, Outcome, ProfilePosition, axis::Handles,
    error::HandleUnit, shared::Shared,
};

/// So long a drive may take to show what it was told in 60B8h.
const ANSWER: Duration = Duration::from_secs(1);

/// One of the two touch probes of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Probe {
    /// Touch probe 1: bits 0 to 7 of 60B8h and 60B9h, positions in 60BAh and 60BBh.
    One,
    /// Touch probe 2: bits 8 to 15 of 60B8h and 60B9h, positions in 60BCh and 60BDh.
    Two,
}

/// One of the two edges of a probe's input.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Edge {
    /// The positive edge: the input becomes active.
    #[default]
    Rising,
    /// The negative edge: the input becomes inactive.
    Falling,
}

impl fmt::Display for Probe {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::One => "touch probe 1",
            Self::Two => "touch probe 2",
        })
    }
}

/// What an edge of a probe is in the drive.
#[derive(Debug, Clone, Copy)]
struct ProbeObjects {
    probe: Probe,
    /// All bits of this probe in 60B8h.
    mask: TouchProbeFunction,
    /// Of these: on, at this edge; and each edge, not the first one alone.
    on: TouchProbeFunction,
    each: TouchProbeFunction,
    enabled: TouchProbeStatus,
    stored: TouchProbeStatus,
    /// All of this probe in 60B9h that is the standard's.
    shown: TouchProbeStatus,
    position: Object<i32, ReadOnly>,
    counter: Object<u16, ReadOnly>,
}

impl ProbeObjects {
    fn of(probe: Probe, edge: Edge) -> Self {
        use {TouchProbeFunction as Function, TouchProbeStatus as Status};
        let (position, counter) = match (probe, edge) {
            (Probe::One, Edge::Rising) => (
                obj::TOUCH_PROBE_1_POSITIVE,
                obj::TOUCH_PROBE_1_POSITIVE_COUNTER,
            ),
            (Probe::One, Edge::Falling) => (
                obj::TOUCH_PROBE_1_NEGATIVE,
                obj::TOUCH_PROBE_1_NEGATIVE_COUNTER,
            ),
            (Probe::Two, Edge::Rising) => (
                obj::TOUCH_PROBE_2_POSITIVE,
                obj::TOUCH_PROBE_2_POSITIVE_COUNTER,
            ),
            (Probe::Two, Edge::Falling) => (
                obj::TOUCH_PROBE_2_NEGATIVE,
                obj::TOUCH_PROBE_2_NEGATIVE_COUNTER,
            ),
        };
        let (at, stored) = match edge {
            Edge::Rising => (Function::POSITIVE_EDGE_1, Status::POSITIVE_STORED_1),
            Edge::Falling => (Function::NEGATIVE_EDGE_1, Status::NEGATIVE_STORED_1),
        };
        // The second probe has the upper byte.
        let shift = match probe {
            Probe::One => 0,
            Probe::Two => 8,
        };
        let function = |bits: Function| Function::from_bits_retain(bits.bits() << shift);
        let status = |bits: Status| Status::from_bits_retain(bits.bits() << shift);
        Self {
            probe,
            mask: function(Function::from_bits_retain(0x00FF)),
            on: function(Function::ENABLE_1 | at),
            each: function(Function::CONTINUOUS_1),
            enabled: status(Status::ENABLED_1),
            stored: status(stored),
            shown: status(
                Status::ENABLED_1 | Status::POSITIVE_STORED_1 | Status::NEGATIVE_STORED_1,
            ),
            position,
            counter,
        }
    }
}

/// A touch probe that is not armed yet, from [`Axis::probe`]. Nothing was sent.
///
/// ```
/// # use core::time::Duration;
/// # use servocrab::{AxisConfig, DriveConfig, Network, Referencing, coe::obj, drives, link::Wire};
/// # use servocrab_sim::{Segment, ds402::Mark, personality::Servo};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # smol::block_on(async {
/// # // A part from 12 345 to 14 000 counts.
/// # let part = Mark::new(12_345, 14_000);
/// # let servo = Servo::generic().change(move |drive| drive.machine.probes[0] = Some(part));
/// # let mut segment = Segment::new().with(servo.build());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// use servocrab::{SetPoint, axis::{Edge, Probe}};
/// let x = AxisConfig::new("x")
///     .map_output(obj::TOUCH_PROBE_FUNCTION)
///     .map_input(obj::TOUCH_PROBE_STATUS)
///     .map_input(obj::TOUCH_PROBE_1_POSITIVE);
/// # let x = x.referencing(Referencing::UnreferencedMovesAllowed);
/// # let drive = DriveConfig::new(drives::generic()).axis(x);
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// let x = net.axis("x")?;
/// x.enable().await?;
/// let probe = x.probe(Probe::One).edge(Edge::Rising).within(10_000, 15_000).arm().await?;
/// let positions = x.profile_position().await?;
/// let motion = positions.move_abs(20_000, SetPoint::new().velocity(100_000)).await?;
/// let edge = probe.latched().await?; // the axis moves on
/// assert_eq!(edge, 12_345);
/// motion.done().await?;
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
#[must_use = "nothing is sent until it is armed"]
#[derive(Debug, Clone)]
pub struct ProbeRequest<U: AxisUnit = Counts> {
    axis: Axis<U>,
    probe: Probe,
    edge: Edge,
    window: Option<(U::Signed, U::Signed)>,
}

impl<U: AxisUnit> Axis<U> {
    /// A touch probe of this axis: at an edge of its input the drive holds the position (60BAh to 60BDh), beside whatever moves the axis.
    ///
    /// Map touch probe function 60B8h ([`AxisConfig::map_output`](crate::AxisConfig::map_output)), touch probe status 60B9h and the position
    /// ([`map_input`](crate::AxisConfig::map_input)): then the edge is known in the cycle after it. What is not mapped goes by SDO. That takes
    /// some cycles for each look at 60B9h, and the position is as exact.
    pub fn probe(&self, probe: Probe) -> ProbeRequest<U> {
        ProbeRequest {
            axis: self.clone(),
            probe,
            edge: Edge::default(),
            window: None,
        }
    }
}

impl<U: AxisUnit> ProbeRequest<U> {
    /// The edge at which the position is held; without it [`Edge::Rising`].
    pub const fn edge(mut self, edge: Edge) -> Self {
        self.edge = edge;
        self
    }

    /// Only an edge at a position from the first to the last one counts, both included. On a modulo axis a first position above the last one
    /// leads across the end of the turn.
    ///
    /// After an edge outside of it the probe is armed again. That takes some cycles, and an edge in these is not seen:
    /// [`arm_continuous`](Self::arm_continuous) sees it.
    pub const fn within(mut self, first: U::Signed, last: U::Signed) -> Self {
        self.window = Some((first, last));
        self
    }

    /// Arms the probe for its first edge from now on; resolves when the drive shows it enabled (60B9h). Of an input that bounces the first
    /// edge counts.
    ///
    /// The probe's bits in 60B8h are 0 before, until the drive has shown it off: what an earlier probe has left in 60B9h and 60BAh is no
    /// edge. The bits of the other probe stay as the program has set them; those that a start-up line has set in a mapped 60B8h do not.
    ///
    /// # Errors
    /// [`AxisErrorKind::Probe`]: [`InUse`](ProbeError::InUse), [`Unreadable`](ProbeError::Unreadable) for an object that is neither mapped
    /// nor readable, [`NoAnswer`](ProbeError::NoAnswer) where the drive does not show in time what it was told, and
    /// [`EmptyWindow`](ProbeError::EmptyWindow). [`AxisErrorKind::Scale`] for a window that cannot be converted into counts,
    /// [`AxisErrorKind::Sdo`], in Fault, and when the bus is lost.
    pub async fn arm(self) -> Result<ArmedProbe<U>, AxisError> {
        let latch = self.latch(Edges::First).await?;
        latch.arm().await?;
        Ok(ArmedProbe {
            latch,
            armed: smol::lock::Mutex::new(true),
            of_unit: PhantomData,
        })
    }

    /// As [`arm`](Self::arm), for each edge. The drive must have the counter of this edge (60D5h to 60D8h), mapped or readable: without it
    /// two edges at the same position are one.
    ///
    /// # Errors
    /// As [`arm`](Self::arm).
    pub async fn arm_continuous(self) -> Result<ContinuousProbe<U>, AxisError> {
        let latch = self.latch(Edges::Each).await?;
        let seen = latch.arm().await?;
        Ok(ContinuousProbe {
            latch,
            counted: seen.counted(),
            of_unit: PhantomData,
        })
    }

    async fn latch(self, edges: Edges) -> Result<Latch, AxisError> {
        let Self {
            axis,
            probe,
            edge,
            window,
        } = self;
        let shared = &axis.handles.shared;
        let turn = shared.notes.settings().turn;
        let counts = |position: U::Signed| {
            let counts = axis.unit.scale.position(position.into());
            counts.map_err(|error| axis.scale_error(error))
        };
        let window = match window {
            None => None,
            Some((first, last)) => {
                let window = Window::new(counts(first)?, counts(last)?, turn);
                Some(window.ok_or_else(|| {
                    shared.error(AxisErrorKind::Probe(ProbeError::EmptyWindow {
                        first: first.into(),
                        last: last.into(),
                    }))
                })?)
            }
        };
        let objects = ProbeObjects::of(probe, edge);
        let (layout, offset) = (&shared.setup.layout, shared.setup.offset);
        // A position that is mapped is of the same frame as its status and its counter. One that is read by SDO is of after them.
        let status = layout.input(obj::TOUCH_PROBE_STATUS.offset(offset)).ok();
        let position = layout.input(objects.position.offset(offset)).ok();
        let position = position.filter(|_| status.is_some());
        let counter = layout.input(objects.counter.offset(offset)).ok();
        let counter = counter.filter(|_| position.is_some());
        let position = position.filter(|_| edges == Edges::First || counter.is_some());
        let function = obj::TOUCH_PROBE_FUNCTION.offset(offset);
        let function = match layout.output(function) {
            Ok(_) => shared.outputs.place_of(function.address()),
            Err(_) => None,
        };
        let latch = Latch {
            hold: Hold::take(shared, objects, function)?,
            handles: Arc::clone(&axis.handles),
            unit: axis.unit,
            objects,
            edges,
            status,
            position,
            counter,
            turn,
            window,
            was_enabled: AtomicBool::new(false),
            shown: AtomicU16::new(0),
        };
        if function.is_none() {
            latch.check_there(obj::TOUCH_PROBE_FUNCTION).await?;
        }
        if status.is_none() {
            latch.check_there(obj::TOUCH_PROBE_STATUS).await?;
        }
        if position.is_none() {
            latch.check_there(objects.position).await?;
        }
        if edges == Edges::Each && counter.is_none() {
            latch.check_there(objects.counter).await?;
        }
        Ok(latch)
    }
}

/// A touch probe that is armed for one edge, from [`ProbeRequest::arm`].
///
/// Dropped, it is disarmed in the next frame: its bits in 60B8h become 0, those of the other probe stay. Where 60B8h goes by SDO,
/// [`disarm`](Self::disarm) writes it; a dropped one stays armed in the drive, where nobody looks, until the probe is armed again.
#[must_use = "dropped, it is disarmed"]
#[derive(Debug)]
pub struct ArmedProbe<U: AxisUnit = Counts> {
    latch: Latch,
    /// Not while it is being armed again.
    armed: smol::lock::Mutex<bool>,
    of_unit: PhantomData<U>,
}

impl<U: AxisUnit> ArmedProbe<U> {
    /// Waits for the edge; gives the position that the drive has held there (60BAh to 60BDh), in the axis' unit. Asked again it is the same
    /// one. There is no deadline.
    ///
    /// # Errors
    /// When the axis leaves Operation enabled: [`Failure::QuickStopped`], [`Failure::Disabled`] or [`Failure::Fault`]; a halt does not end
    /// it. [`Failure::BusLost`]. [`AxisErrorKind::Probe`] when the drive has switched the probe off, or does not answer while it is armed
    /// again. [`AxisErrorKind::Sdo`].
    pub async fn latched(&self) -> Result<U::Signed, AxisError> {
        let mut armed = self.armed.lock().await;
        loop {
            if !*armed {
                self.latch.arm().await?;
                *armed = true;
            }
            let position = self.latch.until_stored().await?;
            if self.latch.is_within(position) {
                return Ok(self.latch.unit.scale.position_in::<U>(position));
            }
            *armed = false;
        }
    }

    /// Disarms the probe; resolves when the drive shows it off (60B9h).
    ///
    /// # Errors
    /// [`ProbeError::NoAnswer`], [`AxisErrorKind::Sdo`], or when the bus is lost.
    pub async fn disarm(self) -> Result<(), AxisError> {
        self.latch.switch_off().await
    }

    /// The edge, if there was one: nothing is waited for but a look.
    async fn latched_yet(&self) -> Result<Option<U::Signed>, AxisError> {
        if !*self.armed.lock().await {
            return Ok(None);
        }
        let seen = self.latch.look_now().await?;
        let position = seen.position.filter(|at| self.latch.is_within(*at));
        Ok(position.map(|at| self.latch.unit.scale.position_in::<U>(at)))
    }
}

/// A touch probe that is armed for each edge, from [`ProbeRequest::arm_continuous`]. Dropped, it is disarmed as an [`ArmedProbe`] is.
#[must_use = "dropped, it is disarmed"]
#[derive(Debug)]
pub struct ContinuousProbe<U: AxisUnit = Counts> {
    latch: Latch,
    /// The drive's counter at the last look; none where edges since it was armed are not all counted.
    counted: Option<u16>,
    of_unit: PhantomData<U>,
}

/// An edge of a [`ContinuousProbe`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct ProbedEdge<U: AxisUnit = Counts> {
    /// The position that the drive has held there (60BAh to 60BDh).
    pub position: U::Signed,
    /// How many edges came between the one before and this one, by the drive's counter: the positions of these are lost.
    pub missed: u16,
}

impl<U: AxisUnit> ContinuousProbe<U> {
    /// Waits for the next edge. The drive holds the position of the latest one alone. So edges that follow each other faster than this is
    /// called, or than the cycle, are counted as missed.
    ///
    /// # Errors
    /// As [`ArmedProbe::latched`].
    pub async fn latched(&mut self) -> Result<ProbedEdge<U>, AxisError> {
        loop {
            if let Some(seen) = self.latch.look().await? {
                let before = self.counted;
                let new = match (seen.position, before) {
                    (None, _) => 0,
                    (Some(_), None) => 1,
                    (Some(_), Some(before)) => seen.counter.wrapping_sub(before),
                };
                // Without a position its edge is still to be seen.
                if seen.position.is_some() {
                    self.counted = Some(seen.counter);
                }
                if let Some(position) = seen.position
                    && new > 0
                    && self.latch.is_within(position)
                {
                    return Ok(ProbedEdge {
                        position: self.latch.unit.scale.position_in::<U>(position),
                        missed: new - 1,
                    });
                }
                self.latch.check_shown(&seen)?;
            }
            self.latch.check_axis().await?;
            self.latch.next_cycle().await?;
        }
    }

    /// Disarms the probe; resolves when the drive shows it off (60B9h).
    ///
    /// # Errors
    /// As [`ArmedProbe::disarm`].
    pub async fn disarm(self) -> Result<(), AxisError> {
        self.latch.switch_off().await
    }
}

/// How a move until a probe's edge ended: [`ProfilePosition::move_until_probe`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Probed<U: AxisUnit = Counts> {
    /// The edge came, and the axis was stopped.
    Edge {
        /// The position that the drive has held at the edge. The axis stands behind it.
        position: U::Signed,
    },
    /// The move has ended without an edge.
    NoEdge(Outcome<U>),
}

impl<U: AxisUnit> ProfilePosition<U> {
    /// Arms a probe, then moves until its edge or to the end of the move.
    ///
    /// At the edge the move is over in each case, and its set-point is gone. Where the drive takes a set-point while it is halted
    /// ([`Axis::stop_and_hold`]) the axis stays enabled; on any other drive it is stopped by [`Axis::stop`]. Call [`Axis::enable`] before the
    /// next move: it does nothing on an axis that is enabled. The program's task asks for the stop when it is woken, so the axis goes on for a
    /// cycle or two and its ramp. The position of the edge does not depend on that.
    ///
    /// Map the probe's objects for it: by SDO the stop comes as late as the mailbox answers.
    ///
    /// Dropped, the axis is halted. A halt by somebody else ends nothing: after a resume the probe is armed still. An input that is active
    /// from the start has no edge: look at 60FDh before.
    ///
    /// ```
    /// # use servocrab::{AxisConfig, DriveConfig, Network, coe::obj, drives, link::Wire};
    /// # use servocrab_sim::{Segment, ds402::Mark, personality::Servo};
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # smol::block_on(async {
    /// # let servo = Servo::generic().change(|drive| drive.machine.probes[0] = Some(Mark::new(12_345, i64::MAX)));
    /// # let mut segment = Segment::new().with(servo.build());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let x = AxisConfig::new("x")
    /// #     .map_output(obj::TOUCH_PROBE_FUNCTION)
    /// #     .map_input(obj::TOUCH_PROBE_STATUS)
    /// #     .map_input(obj::TOUCH_PROBE_1_POSITIVE);
    /// # let drive = DriveConfig::new(drives::generic()).axis(x);
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// use servocrab::{SetPoint, axis::{Probe, Probed}};
    /// let x = net.axis("x")?;
    /// x.enable().await?;
    /// let positions = x.profile_position().await?;
    /// let slowly = positions.rel(50_000, SetPoint::new().velocity(20_000));
    /// match positions.move_until_probe(slowly, x.probe(Probe::One)).await? {
    ///     Probed::Edge { position } => println!("the part begins at {position}"),
    ///     Probed::NoEdge(outcome) => println!("no part: {outcome}"),
    /// }
    /// x.enable().await?;
    /// positions.move_rel(-5_000, SetPoint::new()).await?.done().await?;
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    ///
    /// # Errors
    /// As [`ProbeRequest::arm`], [`move_abs`](Self::move_abs) and [`Move::done_through_halt`](crate::Move::done_through_halt). Where the wait
    /// for the edge fails as [`ArmedProbe::latched`] does, or the stop at the edge fails: the axis is stopped first, if it can be.
    pub async fn move_until_probe(
        &self,
        mut request: MoveRequest<U>,
        probe: ProbeRequest<U>,
    ) -> Result<Probed<U>, AxisError> {
        let axis = request.axis.clone();
        // A stop that comes while the probe is being armed stops this move as well.
        let asked = axis.handles.shared.stops.last();
        let armed = probe.arm().await?;
        // Nobody else knows of the edge.
        request.command.set_point.halt_on_drop = true;
        let motion = request.send_asked(asked).await?;
        let edge = async { First::Edge(armed.latched().await) };
        let end = async { First::End(motion.done_through_halt().await) };
        let first = smol::future::or(edge, end).await;
        match first {
            First::Edge(edge) => {
                let ended = axis.end_move().await;
                let position = edge?;
                ended.map(|()| Probed::Edge { position })
            }
            First::End(outcome) => {
                let outcome = outcome?;
                let edge = armed.latched_yet().await?;
                Ok(match edge {
                    Some(position) => Probed::Edge { position },
                    None => Probed::NoEdge(outcome),
                })
            }
        }
    }
}

/// What comes first.
enum First<U: AxisUnit> {
    Edge(Result<U::Signed, AxisError>),
    End(Result<Outcome<U>, AxisError>),
}

impl<U: AxisUnit> Axis<U> {
    /// Ends the move, whose set-point is gone then.
    async fn end_move(&self) -> Result<(), AxisError> {
        // Of another drive that is known before: asked in vain it would cost two cycles of motion.
        let traits = self.handles.shared.notes.settings().traits;
        if traits.acknowledges_while_halted {
            let held = self.stop_and_hold().await;
            match held.as_ref().map_err(AxisError::failure) {
                Err(Some(Failure::Unsupported(Unsupported::Hold { .. }))) => {}
                _ => return held,
            }
        }
        self.stop().await.map(drop)
    }
}

/// What is wrong with a touch probe.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum ProbeError {
    /// The probe is armed already. Disarm it first, or drop it.
    #[error("{probe} is armed already: disarm it first")]
    InUse {
        /// The probe.
        probe: Probe,
    },
    /// The object is not in the process data, and cannot be read by SDO either: the drive may have no touch probe.
    #[error(
        "{object} is not in the process data and cannot be read by SDO ({error}): map it, if the drive has it"
    )]
    Unreadable {
        /// The object, as the drive numbers it for this axis.
        object: ObjectAddress,
        /// What reading it gave.
        error: Arc<SdoError>,
    },
    /// The drive does not show in time what it was told.
    #[error(
        "{probe} is not {} within {within:?}: touch probe status 60B9h shows {status:04X}h",
        if *.on { "enabled" } else { "switched off" }
    )]
    NoAnswer {
        /// The probe.
        probe: Probe,
        /// Whether it was to be enabled, or off.
        on: bool,
        /// The deadline.
        within: Duration,
        /// 60B9h as it was seen last.
        status: u16,
    },
    /// The drive has switched the probe off without being told: another master or program may have, or a change of mode.
    #[error("{probe} was switched off by the drive (60B9h shows {status:04X}h): arm it again")]
    SwitchedOff {
        /// The probe.
        probe: Probe,
        /// 60B9h.
        status: u16,
    },
    /// The window's first position is above its last one, and the axis has no turn across whose end it could lead.
    #[error("the window from {first} to {last} is empty: give the lower position first")]
    EmptyWindow {
        /// In the unit of the handle.
        first: f64,
        /// In the unit of the handle.
        last: f64,
    },
}

/// The positions at which an edge counts, in counts.
#[derive(Debug, Clone, Copy)]
struct Window {
    first: i64,
    last: i64,
    /// How many positions a turn has.
    turn: Option<i64>,
}

impl Window {
    /// None where it is empty.
    fn new(first: i32, last: i32, turn: Option<PositionRange>) -> Option<Self> {
        let turn = turn.and_then(|turn| turn.length()).map(i64::from);
        let window = Self {
            first: first.into(),
            last: last.into(),
            turn,
        };
        (turn.is_some() || first <= last).then_some(window)
    }

    fn contains(self, position: i32) -> bool {
        let (at, span) = (i64::from(position) - self.first, self.last - self.first);
        match self.turn {
            Some(turn) => span >= turn || at.rem_euclid(turn) <= span.rem_euclid(turn),
            None => (0..=span).contains(&at),
        }
    }
}

/// Which edges the drive holds the position of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Edges {
    First,
    Each,
}

/// A probe of which this is the only user. Dropped, it is switched off and given back.
#[derive(Debug)]
struct Hold {
    shared: Arc<Shared>,
    objects: ProbeObjects,
    /// Where 60B8h is in the outputs; none where it goes by SDO.
    function: Option<usize>,
}

impl Hold {
    fn take(
        shared: &Arc<Shared>,
        objects: ProbeObjects,
        function: Option<usize>,
    ) -> Result<Self, AxisError> {
        let mask = objects.mask.bits();
        if shared.probes.fetch_or(mask, Ordering::AcqRel) & mask != 0 {
            let probe = objects.probe;
            return Err(shared.error(AxisErrorKind::Probe(ProbeError::InUse { probe })));
        }
        Ok(Self {
            shared: Arc::clone(shared),
            objects,
            function,
        })
    }

    /// This probe's bits of the mapped 60B8h.
    fn set(&self, cell: usize, bits: TouchProbeFunction) {
        let mask = self.objects.mask.bits();
        self.shared
            .change_output(cell, mask.into(), bits.bits().into());
    }
}

impl Drop for Hold {
    fn drop(&mut self) {
        if let Some(cell) = self.function {
            self.set(cell, TouchProbeFunction::empty());
        }
        let mask = self.objects.mask.bits();
        self.shared.probes.fetch_and(!mask, Ordering::AcqRel);
    }
}

/// A probe at work, in counts.
#[derive(Debug)]
struct Latch {
    // First: it is switched off before the axis' last handle goes.
    hold: Hold,
    handles: Arc<Handles>,
    unit: HandleUnit,
    objects: ProbeObjects,
    edges: Edges,
    /// What is mapped, and is read there.
    status: Option<pdo_map::Field<u16>>,
    position: Option<pdo_map::Field<i32>>,
    counter: Option<pdo_map::Field<u16>>,
    turn: Option<PositionRange>,
    window: Option<Window>,
    /// Whether the axis was in Operation enabled since.
    was_enabled: AtomicBool,
    /// 60B9h as it was seen last.
    shown: AtomicU16,
}

/// What one look has shown.
#[derive(Debug, Clone, Copy)]
struct Look {
    /// The cycle whose frame brought it; of what was read by SDO, one before that.
    cycle: u64,
    status: TouchProbeStatus,
    /// Where the edge was, if there was one since the probe was armed.
    position: Option<i32>,
    /// Of a continuous one.
    counter: u16,
}

impl Look {
    /// What the counter begins with; none where an edge came before it was looked at.
    fn counted(&self) -> Option<u16> {
        self.position.is_none().then_some(self.counter)
    }
}

impl Latch {
    fn shared(&self) -> &Shared {
        &self.handles.shared
    }

    fn error(&self, error: ProbeError) -> AxisError {
        self.shared().error(AxisErrorKind::Probe(error))
    }

    fn is_within(&self, position: i32) -> bool {
        self.window.is_none_or(|window| window.contains(position))
    }

    /// Switches the probe on, after the drive has shown it off; gives what the drive showed then.
    async fn arm(&self) -> Result<Look, AxisError> {
        self.switch_off().await?;
        let each = match self.edges {
            Edges::First => TouchProbeFunction::empty(),
            Edges::Each => self.objects.each,
        };
        let enabled = async {
            self.write_function(self.objects.on | each).await?;
            loop {
                self.check_axis().await?;
                self.next_cycle().await?;
                if let Some(seen) = self.look().await?
                    && seen.status.contains(self.objects.enabled)
                {
                    return Ok(seen);
                }
            }
        };
        smol::future::or(enabled, self.no_answer(true)).await
    }

    /// Ready when the drive shows the probe off, after it would have shown it on.
    async fn switch_off(&self) -> Result<(), AxisError> {
        let off = async {
            self.write_function(TouchProbeFunction::empty()).await?;
            // The status of before may be 0 as well, of a probe that was armed and given up at once: the drive has its own cycle.
            let signals = &self.shared().setup.groups.signals;
            let seen = self.shared().notes.settings().traits.surely_seen();
            let seen = signals.sleep_until(signals.now().saturating_add(seen));
            smol::future::or(seen, self.shared().until_closed()).await;
            let after = self.shared().snapshot().cycle.saturating_add(1);
            loop {
                self.next_cycle().await?;
                if let Some(seen) = self.look().await?
                    && seen.cycle >= after
                    && !seen.status.intersects(self.objects.shown)
                {
                    return Ok(());
                }
            }
        };
        smol::future::or(off, self.no_answer(false)).await
    }

    /// The error for a drive that does not show in time what it was told.
    async fn no_answer<T>(&self, on: bool) -> Result<T, AxisError> {
        let signals = &self.shared().setup.groups.signals;
        signals
            .sleep_until(signals.now().saturating_add(ANSWER))
            .await;
        Err(self.error(ProbeError::NoAnswer {
            probe: self.objects.probe,
            on,
            within: ANSWER,
            status: self.shown.load(Ordering::Relaxed),
        }))
    }

    /// The position at the edge, once there is one.
    async fn until_stored(&self) -> Result<i32, AxisError> {
        loop {
            if let Some(seen) = self.look().await? {
                if let Some(position) = seen.position {
                    return Ok(position);
                }
                self.check_shown(&seen)?;
            }
            self.check_axis().await?;
            self.next_cycle().await?;
        }
    }

    /// The next look that there is.
    async fn look_now(&self) -> Result<Look, AxisError> {
        loop {
            if let Some(seen) = self.look().await? {
                return Ok(seen);
            }
            self.next_cycle().await?;
        }
    }

    fn check_shown(&self, seen: &Look) -> Result<(), AxisError> {
        if seen.status.contains(self.objects.enabled) {
            return Ok(());
        }
        Err(self.error(ProbeError::SwitchedOff {
            probe: self.objects.probe,
            status: seen.status.bits(),
        }))
    }

    /// Why there is to be no edge any more: the axis has left Operation enabled, or has a fault.
    async fn check_axis(&self) -> Result<(), AxisError> {
        let state = self.shared().snapshot().state;
        // One statusword suffices: the axis is stopped by it.
        let failure = match state {
            State::OperationEnabled => {
                self.was_enabled.store(true, Ordering::Relaxed);
                return Ok(());
            }
            State::Fault | State::FaultReactionActive => Failure::Fault {
                code: None,
                following_error: false,
            },
            // Of an axis that is moved by hand there is an edge as well.
            _ if !self.was_enabled.load(Ordering::Relaxed) => return Ok(()),
            State::QuickStopActive => Failure::QUICK_STOPPED,
            _ => Failure::Disabled { state },
        };
        Err(self.handles.fail(failure).await.in_unit(self.unit))
    }

    /// Waits for the next cycle of a drive that is there.
    async fn next_cycle(&self) -> Result<(), AxisError> {
        let shared = self.shared();
        if shared.is_closed() || shared.snapshot().lost {
            let delivery = Delivery::NotSent;
            let lost = Failure::BusLost { delivery };
            return Err(shared.error(AxisErrorKind::Failed(lost)));
        }
        let signals = &shared.setup.groups.signals;
        let next = signals.now().saturating_add(Duration::from_nanos(1));
        smol::future::or(signals.sleep_until(next), shared.until_closed()).await;
        Ok(())
    }

    /// What the drive shows; none where the last cycle brought no inputs.
    async fn look(&self) -> Result<Option<Look>, AxisError> {
        let shared = self.shared();
        // As for a snapshot: an axis at rest is as it was in the last of these.
        let cycles = shared.setup.groups.signals.cycles();
        let sampled = shared.status.sample(|snapshot, inputs| {
            let status = self.status.map(|field| inputs.value(field));
            let position = self.position.map(|field| inputs.value(field));
            let counter = self.counter.map(|field| inputs.value(field));
            let cycle = snapshot.cycle.max(cycles);
            snapshot
                .answered
                .then_some((cycle, status, position, counter))
        });
        let Some((cycle, status, position, counter)) = sampled else {
            return Ok(None);
        };
        let status = match status {
            Some(status) => status,
            None => self.read(obj::TOUCH_PROBE_STATUS).await?,
        };
        self.shown.store(status, Ordering::Relaxed);
        let status = TouchProbeStatus::from_bits_retain(status);
        let is_stored = status.contains(self.objects.stored);
        let (position, counter) = match (self.edges, position, counter) {
            (Edges::First, ..) if !is_stored => (None, 0),
            (Edges::First, Some(position), _) => (Some(position), 0),
            (Edges::First, None, _) => (Some(self.read(self.objects.position).await?), 0),
            (Edges::Each, Some(position), Some(counter)) => {
                (is_stored.then_some(position), counter)
            }
            (Edges::Each, ..) => {
                let (position, counter) = self.read_counted().await?;
                (is_stored.then_some(position), counter)
            }
        };
        let in_turn = |position: i32| match self.turn {
            Some(turn) => turn.wrap(position.into()),
            None => position,
        };
        Ok(Some(Look {
            cycle,
            status,
            position: position.map(in_turn),
            counter,
        }))
    }

    /// A position and the number of its edge. Where edges come faster than they are read it is that of one of them.
    async fn read_counted(&self) -> Result<(i32, u16), AxisError> {
        let mut counter = self.read(self.objects.counter).await?;
        let mut tries = 3;
        loop {
            let position = self.read(self.objects.position).await?;
            let after = self.read(self.objects.counter).await?;
            tries -= 1;
            if after == counter || tries == 0 {
                return Ok((position, after));
            }
            counter = after;
        }
    }

    /// This probe's bits of 60B8h.
    async fn write_function(&self, bits: TouchProbeFunction) -> Result<(), AxisError> {
        if let Some(cell) = self.hold.function {
            self.hold.set(cell, bits);
            return Ok(());
        }
        // The other probe's are read and written with it.
        let _turn = self.shared().probe_turn.lock().await;
        let held: u16 = self.read(obj::TOUCH_PROBE_FUNCTION).await?;
        let value = held & !self.objects.mask.bits() | bits.bits();
        let object = obj::TOUCH_PROBE_FUNCTION.address();
        self.handles.write_parameter(object, value.encode()).await
    }

    async fn read<T: Number, A: Readable>(&self, object: Object<T, A>) -> Result<T, AxisError> {
        let bytes = self.handles.read_parameter(object.address()).await?;
        T::decode(&bytes).ok_or_else(|| {
            let error = SdoError::WrongSize {
                transfer: Transfer::read(self.handles.of_axis(object.address())),
                expected: usize::from(T::BITS / 8),
                got: bytes.len(),
            };
            self.shared().error(AxisErrorKind::Sdo(Arc::new(error)))
        })
    }

    async fn check_there<T: Number, A: Readable>(
        &self,
        object: Object<T, A>,
    ) -> Result<(), AxisError> {
        match self.read(object).await {
            Ok(_) => Ok(()),
            Err(AxisError {
                kind: AxisErrorKind::Sdo(error),
                ..
            }) => Err(self.error(ProbeError::Unreadable {
                object: self.handles.of_axis(object.address()),
                error,
            })),
            Err(error) => Err(error),
        }
    }
}
