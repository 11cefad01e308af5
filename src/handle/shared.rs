//! What the handles of an axis share with the bus thread. The bus thread meets only atomics and queues here, and never a lock.

use core::{
    fmt,
    sync::atomic::{AtomicBool, AtomicU16, AtomicU64, Ordering},
};
use std::sync::Arc;

use crate::{
    Failure, StopRequest,
    axis::{AxisCore, Brake, Command, Completion, Snapshot},
    coe::obj,
    pdo_map,
    profile_position::LimitsRule,
    wakes::Waiters,
};

use super::{
    AxisError, AxisErrorKind, AxisIdentity, AxisSetup, PairError,
    drive_notes::DriveNotes,
    output_cells::OutputCells,
    queue::Queue,
    request::{AxisRequest, CHANGED},
    statistics::AxisCounts,
    status::StatusCell,
    stops::{LastStop, Stops},
};

/// One axis, seen from both sides.
pub(super) struct Shared {
    pub setup: AxisSetup,
    pub limits_rule: LimitsRule,
    pub identity: Arc<AxisIdentity>,
    pub status: StatusCell,
    measured: Measured,
    pub counts: AxisCounts,
    pub queue: Queue,
    pub stops: Stops,
    pub notes: DriveNotes,
    pub outputs: OutputCells,
    /// The touch probes that are in use: all bits of each in 60B8h.
    pub probes: AtomicU16,
    /// Held by a future that changes 60B8h by SDO.
    pub probe_turn: smol::lock::Mutex<()>,
    pub waiters: Arc<Waiters>,
    /// How often a snapshot has shown something new.
    pub changes: AtomicU64,
    /// How often a mode was leased, or given back: odd while one is leased, and then the number of that lease.
    lease: AtomicU64,
    /// Bits 11 to 15 of the controlword, as the program has set them last.
    pub manufacturer: AtomicU16,
    /// Whether the program has stored anything for the bus thread since it looked last.
    pub asked: AtomicBool,
    pub closed: AtomicBool,
    /// Whether a pair has it.
    pub paired: AtomicBool,
    /// Whether its drive has lost its position since its pair looked last.
    pub displaced: AtomicBool,
}

/// What a drive may send of its axis beside what the core reads.
#[derive(Debug, Clone, Copy)]
struct Measured {
    following_error: Option<pdo_map::Field<i32>>,
    torque: Option<pdo_map::Field<i16>>,
    error_code: Option<pdo_map::Field<u16>>,
}

impl Measured {
    fn of(setup: &AxisSetup) -> Self {
        let (layout, offset) = (&setup.layout, setup.offset);
        Self {
            following_error: layout
                .input(obj::FOLLOWING_ERROR_ACTUAL.offset(offset))
                .ok(),
            torque: layout.input(obj::TORQUE_ACTUAL.offset(offset)).ok(),
            error_code: layout.input(obj::ERROR_CODE.offset(offset)).ok(),
        }
    }
}

impl Shared {
    pub fn new(setup: AxisSetup, core: &AxisCore) -> Self {
        let settings = core.drive_settings();
        let owned = match &settings.brake {
            Some(Brake::Output(brake)) => {
                let object = obj::DIGITAL_OUTPUTS.offset(setup.offset).address();
                Some((object, brake.bit()))
            }
            Some(Brake::DriveManaged) | None => None,
        };
        Self {
            limits_rule: *core.limits_rule(),
            identity: Arc::new(setup.identity.clone()),
            status: StatusCell::new(&core.snapshot(), setup.layout.input_bytes()),
            measured: Measured::of(&setup),
            counts: AxisCounts::default(),
            queue: Queue::new(),
            stops: Stops::new(),
            notes: DriveNotes::new(settings),
            outputs: OutputCells::of(&setup.layout, owned),
            probes: AtomicU16::new(0),
            probe_turn: smol::lock::Mutex::new(()),
            waiters: setup.groups.signals.waiters(),
            changes: AtomicU64::new(0),
            lease: AtomicU64::new(0),
            manufacturer: AtomicU16::new(0),
            asked: AtomicBool::new(false),
            closed: AtomicBool::new(false),
            paired: AtomicBool::new(false),
            displaced: AtomicBool::new(false),
            setup,
        }
    }

    pub fn error(&self, kind: AxisErrorKind) -> AxisError {
        let texts = &self.setup.error_texts;
        AxisError::new(Arc::clone(&self.identity), kind, texts)
    }

    /// For the program's side alone: a subscriber may lock and allocate.
    pub fn trace(&self, what: &str) {
        tracing::debug!(
            target: super::LOG,
            axis = self.identity.axis,
            drive = %self.identity.drive,
            "{what}"
        );
    }

    pub fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }

    /// The latest snapshot.
    pub fn snapshot(&self) -> Snapshot {
        let measured = self.measured;
        // The axis was as it is in the last of the cycles that there were, or the snapshot is of a later one.
        let cycles = self.setup.groups.signals.cycles();
        self.status.sample(|snapshot, inputs| Snapshot {
            cycle: snapshot.cycle.max(cycles),
            following_error: measured.following_error.map(|field| inputs.value(field)),
            torque: measured.torque.map(|field| inputs.value(field)),
            error_code: measured.error_code.map(|field| inputs.value(field)),
            ..snapshot
        })
    }

    /// Asks for a stop that nobody waits for. It is in the next frame, whatever is queued.
    pub fn request_stop(&self, stop: StopRequest) {
        self.stops.raise(stop);
        self.ask();
    }

    /// Tells the bus thread to look. Call this after all that it is to take in was stored.
    pub fn ask(&self) {
        // An exchange and no store: so the bus thread sees what every thread has stored before it asked, and not only the last one.
        self.asked.swap(true, Ordering::Release);
        // After that: the bus thread hears that some axis was asked, and then finds which.
        self.setup.groups.signals.ask();
    }
}

/// By its name: the rest of it is of no use to a reader of a log.
impl fmt::Debug for Shared {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.identity.axis)
    }
}

// The lease of a mode.

impl Shared {
    /// Leases a mode; false while one is leased. Jogs of earlier leases are let go: the axis belongs to this one.
    pub fn take_lease(&self) -> bool {
        let next = |lease: u64| (!is_leased(lease)).then(|| lease.wrapping_add(1));
        let taken = self
            .lease
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, next)
            .is_ok();
        if taken {
            self.ask();
        }
        taken
    }

    /// The lease is given back.
    pub fn give_lease_back(&self) {
        self.lease.fetch_add(1, Ordering::AcqRel);
    }

    /// The number of the lease, to whoever has it.
    pub fn lease(&self) -> u64 {
        self.lease.load(Ordering::Acquire)
    }

    /// What is asked for by this lease belongs to nobody once it was given back.
    pub fn check_lease(&self, lease: u64) -> Result<(), AxisErrorKind> {
        match self.lease() {
            now if now == lease => Ok(()),
            now if is_leased(now) => Err(AxisErrorKind::ModeInUse),
            _ => Err(AxisErrorKind::NotLeased),
        }
    }

    /// One axis of a pair is not moved alone.
    pub fn check_unpaired(&self) -> Result<(), AxisError> {
        if self.paired.load(Ordering::Acquire) {
            return Err(self.error(AxisErrorKind::Pair(Box::new(PairError::Paired))));
        }
        Ok(())
    }

    /// Whether the axis was leased again after this lease.
    pub fn is_leased_again(&self, lease: u64) -> bool {
        self.lease() > lease.wrapping_add(1)
    }
}

const fn is_leased(lease: u64) -> bool {
    lease % 2 == 1
}

// The program's side.

impl Shared {
    /// Sends a command that was asked for when this was the last stop: a motion does not outlive a later one.
    pub fn submit(
        &self,
        command: Command,
        asked: LastStop,
    ) -> Result<Arc<AxisRequest>, AxisErrorKind> {
        if self.is_closed() {
            return Err(AxisErrorKind::Closed);
        }
        let (lease, stops) = (self.lease(), &self.stops);
        let request = self.queue.submit(command, lease, asked, stops);
        self.ask();
        request
    }

    /// The result, once it is there. If the network has ended before, the result is that.
    pub fn result(&self, request: &AxisRequest) -> Option<Result<Completion, Failure>> {
        // In this order: what was done before the end keeps its result.
        let closed = self.is_closed();
        request.result().or_else(|| {
            let delivery = request.delivery();
            closed.then_some(Err(Failure::BusLost { delivery }))
        })
    }

    /// Holds a jog, at this velocity or at the one that it has.
    pub fn hold_jog(&self, jog: &AxisRequest, to: Option<i32>) -> Result<(), Failure> {
        let limits = self.notes.velocities();
        let checked = limits.check_jog(to.unwrap_or(0), &self.limits_rule);
        let to = match checked {
            Ok(()) => to,
            // One that gets slower and slower comes to a stand.
            Err(Failure::TooSlow { .. }) => Some(0),
            Err(_) => return checked,
        };
        if !jog.hold(to) {
            return Err(Failure::NotHeld);
        }
        self.ask();
        checked
    }

    /// Lets go of a jog: it is in the next frame, whatever is queued.
    pub fn release_jog(&self, jog: &AxisRequest) {
        jog.release();
        self.ask();
    }

    /// Waits until `ready` gives a value: it is asked again whenever there is an event of this request.
    pub async fn until<T>(&self, request: &AxisRequest, ready: impl FnMut() -> Option<T>) -> T {
        self.waiters.until(request.channel(), ready).await
    }

    /// Waits for the end of the network.
    pub async fn until_closed(&self) {
        let is_closed = || self.is_closed().then_some(());
        self.waiters.until(CHANGED, is_closed).await;
    }

    /// Waits for the next change; false if there can be none any more. The end is one.
    pub async fn until_changed(&self) -> bool {
        // In this order, as they are stored in the other one: a task that begins to wait after the end knows of it.
        let before = self.changes.load(Ordering::Acquire);
        let _watch = self.setup.groups.signals.watch();
        self.waiters
            .until(CHANGED, || {
                let is_closed = self.is_closed();
                let is_changed = self.changes.load(Ordering::Acquire) != before;
                (is_changed || is_closed).then_some(is_changed)
            })
            .await
    }

    /// The program has read this from 6061h.
    pub fn note_mode(&self, raw: i8) {
        self.notes.note_mode(raw);
        self.ask();
    }

    /// See [`DriveNotes::note_home_offset`].
    pub fn note_home_offset(&self, start: u64, offset: i32) {
        self.notes.note_home_offset(start, offset);
        self.ask();
    }

    /// Sends these bits of an output from the next cycle on, beside what others have set of it.
    pub fn change_output(&self, cell: usize, mask: u32, bits: u32) {
        if self.outputs.change(cell, mask, bits) {
            self.ask();
        }
    }

    pub fn write_output(&self, cell: usize, raw: u32) {
        if self.outputs.set(cell, raw) {
            self.ask();
        }
    }
}
