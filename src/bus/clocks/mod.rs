//! Distributed clocks: delays and offsets of a line, SYNC0 of its drives, and the way of the cycles into step with the reference clock.
//!
//! `topology` computes and is pure; the accesses are here. The phase controller itself is in `cycle`, which it is part
//! of. It calls `line` and `requests`, and must not know of drives but their setting here.

mod reference;
pub(super) mod topology;

use std::{cell::Cell, rc::Rc, time::Duration};

use super::{
    cycle::{
        reference_clock::{Distribution, LOCK_CYCLES, Phase, bound, extend, to_multiple},
        statistics::ClockStatistics,
    },
    error::{
        AlStatus, AtStep, BringUpStep, DriveFault, NetworkError, OfDevice, ReferenceClock,
        RegisterError,
    },
    event::ClockEvent,
    line::{Found, loop_is_gone},
    log::LogRecord,
    requests::{Context, executor::Time, registers::Registers},
};
use crate::{
    coe::{AbortCode, DriveError, DriveId, Object, ReadWrite, SdoHandle, obj},
    esc,
};
use topology::{Latched, LatchedClock, Ports, Setting, Settings, Width, settings};

/// Bits of the assign-activate word's upper byte, register 0981h.
const UNIT_ON: u16 = 0x0100;
const SYNC0_ON: u16 = 0x0200;
const SYNC1_ON: u16 = 0x0400;

/// A drive's distributed clock in use: its SYNC0 pulses at the same time in every cycle, and the network keeps its cycles in
/// step with that.
///
/// Give it to [`DriveConfig::dc`](crate::DriveConfig::dc). The words for `assign_activate` are in the drive's ESI file
/// (`Dc`, `OpMode`, `AssignActivate`) and in its manual; 0300h, SYNC0 alone, is the usual one.
///
/// ```
/// use servocrab::{DriveConfig, bus::DistributedClock};
/// use servocrab::drives;
/// use std::time::Duration;
///
/// let clock = DistributedClock::new(0x0300).shift(Duration::from_micros(400));
/// let drive = DriveConfig::new(drives::akd2g()).axis("x").dc(clock);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DistributedClock {
    assign_activate: u16,
    cycle: Option<Duration>,
    shift: Option<Duration>,
    sync1_after: Duration,
}

impl DistributedClock {
    /// A clock whose SYNC unit is switched on with this word (registers 0980h and 0981h): SYNC0 once in each cycle of the
    /// network, half a cycle after its frames.
    #[must_use]
    pub const fn new(assign_activate: u16) -> Self {
        Self {
            assign_activate,
            cycle: None,
            shift: None,
            sync1_after: Duration::ZERO,
        }
    }

    /// SYNC0 this long after the network's frames pass the reference clock; it must be less than SYNC0's cycle.
    #[must_use]
    pub const fn shift(mut self, shift: Duration) -> Self {
        self.shift = Some(shift);
        self
    }

    /// SYNC0 with this cycle (09A0h): a multiple or a whole part of the network's, and a multiple of what the drive asks for.
    #[must_use]
    pub const fn sync0_cycle(mut self, cycle: Duration) -> Self {
        self.cycle = Some(cycle);
        self
    }

    /// SYNC1 this long after SYNC0 (09A4h), for words that switch it on, as 0700h.
    #[must_use]
    pub const fn sync1_after(mut self, time: Duration) -> Self {
        self.sync1_after = time;
        self
    }

    /// What is wrong with it for a network with this cycle.
    pub(in crate::bus) fn mistake(&self, period: Duration) -> Option<String> {
        let word = self.assign_activate;
        let (cycle, shift) = (self.cycle(period), self.shift_in(period));
        let divides = |one: Duration, other: Duration| {
            one.as_nanos().checked_rem(other.as_nanos()) == Some(0)
        };
        if word & UNIT_ON == 0 || word & SYNC0_ON == 0 {
            Some(format!(
                "the assign-activate word {word:04X}h does not switch SYNC0 on (bits 8 and 9)"
            ))
        } else if nanoseconds(cycle).is_none() || nanoseconds(self.sync1_after).is_none() {
            Some(format!(
                "SYNC0 each {cycle:?} and SYNC1 {:?} later have no room in registers of 32 bits of nanoseconds",
                self.sync1_after
            ))
        } else if !self.sync1_after.is_zero() && word & SYNC1_ON == 0 {
            Some(format!(
                "the assign-activate word {word:04X}h does not switch SYNC1 on (bit 10), and it is to come {:?} after SYNC0",
                self.sync1_after
            ))
        } else if !divides(cycle, period) && !divides(period, cycle) {
            Some(format!(
                "SYNC0 each {cycle:?} is neither a multiple nor a whole part of the network's cycle of {period:?}"
            ))
        } else if shift >= cycle {
            Some(format!(
                "SYNC0's shift of {shift:?} is not less than its cycle of {cycle:?}"
            ))
        } else {
            None
        }
    }

    /// SYNC0's cycle.
    pub(in crate::bus) fn cycle(&self, period: Duration) -> Duration {
        self.cycle.unwrap_or(period)
    }

    /// How long after the network's frames SYNC0 comes.
    pub(in crate::bus) fn shift_in(&self, period: Duration) -> Duration {
        self.shift.unwrap_or(self.cycle(period).min(period) / 2)
    }

    /// The registers' values: SYNC0's cycle and the time to SYNC1, in nanoseconds.
    pub(in crate::bus) fn cycles(&self, period: Duration) -> (u32, u32) {
        let value = |time| nanoseconds(time).unwrap_or(u32::MAX);
        (value(self.cycle(period)), value(self.sync1_after))
    }

    /// The system time of the first pulse: the first of all possible ones that is not before `earliest`.
    fn first_pulse(&self, earliest: u64, period: Duration) -> u64 {
        let (cycle, _) = self.cycles(period);
        let shift = nanoseconds(self.shift_in(period)).unwrap_or(0);
        let earliest = earliest.saturating_sub(shift.into());
        let ahead = to_multiple(earliest, u64::from(cycle).max(1));
        earliest.saturating_add(ahead).saturating_add(shift.into())
    }
}

fn nanoseconds(time: Duration) -> Option<u32> {
    u32::try_from(time.as_nanos()).ok()
}

// The clocks of a line before its drives are configured: receive times latched and read, delays and offsets written, and
// the reference time given to all so often that each clock learns how fast its crystal is.

const HAS_CLOCK: u16 = 1 << 2;
const CLOCK_OF_64_BITS: u16 = 1 << 3;
/// How often the reference time is distributed at first. With the filter depth of a reset (0935h: 12) a clock averages its
/// deviation over 4096 of them: after these less than a thirtieth of it is left.
const DISTRIBUTIONS: u32 = 15_000;
const LOOK_EVERY: Duration = Duration::from_millis(1);
/// How often a latch that another one has overtaken is made again.
const LATCHES: usize = 5;

/// The clocks of a line after they were set.
#[derive(Debug)]
pub(super) struct Clocks {
    pub distribution: Distribution,
    /// Whose clock is the reference.
    pub reference: DriveId,
    /// The width of each SubDevice's clock, by its place in the line.
    widths: Vec<Option<Width>>,
    /// Nanoseconds that a frame takes from the reference to each clock, by the same places.
    delays: Vec<Option<u32>>,
    /// What is added to the reference's local time: 0 until its device begins anew.
    offset: Cell<u64>,
    /// A time of the reference clock, and when that was: later ones are extended to 64 bits with it.
    known: Cell<(u64, Duration)>,
    /// How the first distributions have ended.
    taught: Cell<Option<Result<(), RegisterError>>>,
    /// Whether the reference showed the same time before and after them.
    stands: Cell<bool>,
}

impl Clocks {
    /// The width of a SubDevice's clock; nothing where it has none.
    pub fn width(&self, position: u16) -> Option<Width> {
        self.widths.get(usize::from(position)).copied().flatten()
    }

    /// The reference clock's time as a frame passes it, and when that frame was back.
    pub async fn now(&self, registers: &Registers) -> Result<(u64, Duration), RegisterError> {
        let low = registers.read(self.distribution.station, esc::SYSTEM_TIME);
        let low = u32::from_le_bytes(low.await?);
        let now = registers.time().now();
        let (time, at) = self.known.get();
        let since = u64::try_from(now.saturating_sub(at).as_nanos()).unwrap_or(u64::MAX);
        let known = (extend(time.wrapping_add(since), low), now);
        self.known.set(known);
        Ok(known)
    }

    /// Takes in a time of the reference that the cycles know, and when that was: by it later ones are extended.
    pub fn remember(&self, time: u64, at: Duration) {
        self.known.set((time, at));
    }

    /// Sets the clock of a SubDevice that has begun anew, where it was at the start, while all others run. The latch changes nothing of
    /// theirs, and neither do the distributions by which this one learns its speed: they get the time that the cycles bring them.
    pub async fn set_anew(
        &self,
        registers: &Registers,
        station: u16,
        position: u16,
    ) -> Result<(), DriveFault> {
        let delay = self.delays.get(usize::from(position)).copied().flatten();
        let (Some(width), Some(delay)) = (self.width(position), delay) else {
            return Err(DriveFault::NoClock);
        };
        let clock = self.latch(registers, station, width).await?;
        let (reference, local) = clock.ok_or(RegisterError::NotAnswered)?;
        let offset = reference.wrapping_add(delay.into()).wrapping_sub(local);
        write_setting(registers, station, Setting { delay, offset }, width).await?;
        self.distribute(registers).await?;
        Ok(())
    }

    /// The times of the reference and of another clock as one frame passes them. None if frames with other latches have come
    /// between again and again.
    async fn latch(
        &self,
        registers: &Registers,
        station: u16,
        width: Width,
    ) -> Result<Option<(u64, u64)>, RegisterError> {
        let reference = async || -> Result<u32, RegisterError> {
            let low = registers.read(self.distribution.station, esc::RECEIVE_TIME_UNIT);
            let local = low.await.map(u32::from_le_bytes)?;
            Ok(local.wrapping_add(self.offset.get() as u32))
        };
        for _ in 0..LATCHES {
            registers.broadcast(esc::RECEIVE_TIMES, &[0; 4]).await?;
            let before = reference().await?;
            let local = read_time(registers, station, esc::RECEIVE_TIME_UNIT, width).await?;
            let (now, _) = self.now(registers).await?;
            if reference().await? == before {
                return Ok(Some((extend(now, before), local)));
            }
        }
        Ok(None)
    }

    /// Distributes the reference time for the first time, while the drives are being configured.
    pub async fn teach(&self, registers: &Registers) {
        let result = self.distribute(registers).await;
        self.taught.set(Some(result));
    }

    async fn distribute(&self, registers: &Registers) -> Result<(), RegisterError> {
        let (before, _) = self.now(registers).await?;
        let mut zeros = 0;
        for _ in 0..DISTRIBUTIONS {
            let station = self.distribution.station;
            let time = registers.distribute(station, esc::SYSTEM_TIME).await?;
            zeros = if time == [0; 4] { zeros + 1 } else { 0 };
            if zeros > 1 {
                // No clock shows that twice. The reference is without power now, and the others must not learn from zeros.
                return Err(RegisterError::NotAnswered);
            }
        }
        let (after, _) = self.now(registers).await?;
        self.stands.set(before as u32 == after as u32);
        Ok(())
    }

    /// Whether the reference clock does not run.
    pub fn stands(&self) -> bool {
        self.stands.get()
    }

    /// Waits until that is over.
    pub async fn are_taught(&self, time: &Rc<Time>) -> Result<(), RegisterError> {
        loop {
            if let Some(result) = self.taught.get() {
                return result;
            }
            time.sleep(LOOK_EVERY).await;
        }
    }
}

/// Sets the clocks of all SubDevices that last, which are so many; the first one is the reference. Nothing if there is none.
pub(super) async fn measure(
    context: &Context,
    line: &[Found],
    lasting: usize,
) -> Result<Option<Rc<Clocks>>, NetworkError> {
    let registers = &context.registers;
    registers
        .broadcast(esc::RECEIVE_TIMES, &[0; 4])
        .await
        .map_err(NetworkError::Line)?;
    let stations = || line.iter().map(|found| found.station);
    let latched = stations().map(|station| read_latched(registers.clone(), station));
    let mut latched = all(context, line, latched).await?;
    for (latched, found) in latched.iter_mut().zip(line) {
        latched.clock = latched.clock.filter(|_| lasts(found, lasting));
    }
    let Some(Settings {
        reference,
        of_each: settings,
    }) = settings(&latched)?
    else {
        return Ok(None);
    };
    let set = stations().zip(&latched).zip(&settings);
    let set = set.map(|((station, latched), setting)| {
        let setting = setting.zip(latched.clock);
        set_clock(registers.clone(), station, setting)
    });
    all(context, line, set).await?;
    let (Some(first), Some(clock)) = (
        line.get(reference),
        latched.get(reference).and_then(|latched| latched.clock),
    ) else {
        return Ok(None);
    };
    let of_each = line.iter().zip(latched.iter().zip(&settings));
    let of_each = of_each.filter(|(found, _)| lasts(found, lasting));
    let (widths, delays) = of_each
        .map(|(_, (latched, set))| {
            let width = latched.clock.map(|clock| clock.width);
            (width, set.as_ref().map(|set| set.delay))
        })
        .unzip();
    Ok(Some(Rc::new(Clocks {
        distribution: Distribution {
            station: first.station,
        },
        reference: first.id.clone(),
        widths,
        delays,
        offset: Cell::new(0),
        known: Cell::new((clock.local, registers.time().now())),
        taught: Cell::new(None),
        stands: Cell::new(false),
    })))
}

/// Whether a device is none of an optional group: those are numbered behind the others.
fn lasts(found: &Found, lasting: usize) -> bool {
    usize::from(found.id.position) < lasting
}

async fn read_latched(registers: Registers, station: u16) -> Result<Latched, RegisterError> {
    let features = u16::from_le_bytes(registers.read(station, esc::FEATURES).await?);
    let ports = u16::from_le_bytes(registers.read(station, esc::DL_STATUS).await?);
    let width = match features & (HAS_CLOCK | CLOCK_OF_64_BITS) {
        bits if bits & HAS_CLOCK == 0 => None,
        HAS_CLOCK => Some(Width::Bits32),
        _ => Some(Width::Bits64),
    };
    let clock = match width {
        None => None,
        Some(width) => {
            let times: [u8; 16] = registers.read(station, esc::RECEIVE_TIMES).await?;
            let mut received = [0; 4];
            for (time, bytes) in received.iter_mut().zip(times.as_chunks().0) {
                *time = u32::from_le_bytes(*bytes);
            }
            let local = read_time(&registers, station, esc::RECEIVE_TIME_UNIT, width).await?;
            Some(LatchedClock {
                width,
                received,
                local,
            })
        }
    };
    Ok(Latched {
        ports: Ports::from_dl_status(ports),
        clock,
    })
}

/// The time in this register.
async fn read_time(
    registers: &Registers,
    station: u16,
    register: u16,
    width: Width,
) -> Result<u64, RegisterError> {
    Ok(match width {
        Width::Bits32 => u32::from_le_bytes(registers.read(station, register).await?).into(),
        Width::Bits64 => u64::from_le_bytes(registers.read(station, register).await?),
    })
}

async fn set_clock(
    registers: Registers,
    station: u16,
    setting: Option<(Setting, LatchedClock)>,
) -> Result<(), RegisterError> {
    let Some((setting, clock)) = setting else {
        return Ok(());
    };
    write_setting(&registers, station, setting, clock.width).await
}

async fn write_setting(
    registers: &Registers,
    station: u16,
    setting: Setting,
    width: Width,
) -> Result<(), RegisterError> {
    write_time(
        registers,
        station,
        esc::SYSTEM_TIME_OFFSET,
        setting.offset,
        width,
    )
    .await?;
    let delay = setting.delay.to_le_bytes();
    registers
        .write(station, esc::SYSTEM_TIME_DELAY, &delay)
        .await?;
    // What the filters hold is of the time before.
    let start: [u8; 2] = registers.read(station, esc::SPEED_COUNTER_START).await?;
    registers
        .write(station, esc::SPEED_COUNTER_START, &start)
        .await
}

/// Writes a time, or the lower half to a clock that has no more.
async fn write_time(
    registers: &Registers,
    station: u16,
    register: u16,
    time: u64,
    width: Width,
) -> Result<(), RegisterError> {
    let bytes = time.to_le_bytes();
    match (width, bytes.first_chunk::<4>()) {
        (Width::Bits32, Some(low)) => registers.write(station, register, low).await,
        _ => registers.write(station, register, &bytes).await,
    }
}

/// Waits for the accesses to all SubDevices, which are under way at the same time.
async fn all<T: 'static, F>(
    context: &Context,
    line: &[Found],
    accesses: impl Iterator<Item = F>,
) -> Result<Vec<T>, NetworkError>
where
    F: Future<Output = Result<T, RegisterError>> + 'static,
{
    let tasks: Option<Vec<_>> = accesses.map(|access| context.spawn(access)).collect();
    let mut results = Vec::with_capacity(line.len());
    for (task, found) in tasks.ok_or_else(loop_is_gone)?.into_iter().zip(line) {
        let result = task.await;
        results.push(result.at(BringUpStep::Clock).of(&found.id)?);
    }
    Ok(results)
}

// SYNC0 of a drive: its synchronisation types in CoE, and the registers of its SYNC unit (ESC data sheet, section I, 9.2).

/// How far ahead the first pulse is set: longer than a few frames can be on their way.
const AHEAD: Duration = Duration::from_millis(100);
/// How often the start is set anew when it had passed before the unit was on.
const TRIES: usize = 3;
/// 1C32h:1 and 1C33h:1, synchronous with SYNC0 (ETG.1020).
const WITH_SYNC0: u16 = 2;
const WITH_SYNC1: u16 = 3;
/// 1C33h:1, synchronous with the outputs.
const WITH_OUTPUTS: u16 = 34;
/// 1C32h:4 and 1C33h:4, bit 1: synchronous with the process data is supported.
const SM_SYNCHRONOUS: u16 = 0x0002;

/// Sets the synchronisation types of a drive that has them, and reads them back. In PREOP.
pub(super) async fn set_sync_types(
    context: &Context,
    sdo: &SdoHandle,
    clock: &DistributedClock,
    period: Duration,
) -> Result<(), DriveFault> {
    let (cycle, _) = clock.cycles(period);
    for (kind, time) in [
        (obj::OUTPUT_SYNC_TYPE, obj::OUTPUT_CYCLE_TIME),
        (obj::INPUT_SYNC_TYPE, obj::INPUT_CYCLE_TIME),
    ] {
        match keeps(sdo, kind, WITH_SYNC0).await? {
            None => continue,
            Some(Kept { value, refused }) if value != WITH_SYNC0 => {
                if refused.is_none() {
                    return Err(DriveFault::SyncType {
                        index: kind.index(),
                        value,
                    });
                }
                // Many drives take it from the SYNC unit alone.
                let (drive, object) = (sdo.drive().clone().into(), kind.address());
                let note = LogRecord::KeepsSyncType {
                    drive,
                    object,
                    value,
                };
                context.log.record(context.time.now(), note);
            }
            Some(_) => {}
        }
        // Where it can be set at all; else the drive takes it from 09A0h.
        if let Some(Kept {
            value,
            refused: None,
        }) = keeps(sdo, time, cycle).await?
            && value != cycle
        {
            let (index, expected) = (time.index(), cycle);
            return Err(DriveFault::SyncCycle {
                index,
                expected,
                value,
            });
        }
    }
    Ok(())
}

/// Whether a drive says by this AL status code that its synchronisation types do not fit what it is given (ETG.1020).
pub(in crate::bus) const fn is_about_types(code: u16) -> bool {
    matches!(code, 0x0027..=0x0029 | 0x0030 | 0x0035..=0x0037)
}

/// Takes a drive out of SYNC0 that is refused because it still asks for it, from an earlier program with distributed clocks. It gets the
/// types that it has by default, or else follows its process data. Whether that has changed anything. In PREOP.
pub(in crate::bus) async fn leave_sync0(
    sdo: &SdoHandle,
    defaults: [Option<u16>; 2],
    status: AlStatus,
) -> Result<bool, DriveFault> {
    let mut has_changed = false;
    let [of_outputs, of_inputs] = defaults;
    for (kind, supported, with_data, default) in [
        (
            obj::OUTPUT_SYNC_TYPE,
            obj::OUTPUT_SYNC_TYPES_SUPPORTED,
            1,
            of_outputs,
        ),
        (
            obj::INPUT_SYNC_TYPE,
            obj::INPUT_SYNC_TYPES_SUPPORTED,
            WITH_OUTPUTS,
            of_inputs,
        ),
    ] {
        let Some(held) = read_if_there(sdo, kind).await? else {
            continue;
        };
        if !asks_for_sync(held) {
            continue;
        }
        let wanted = match default.filter(|default| !asks_for_sync(*default)) {
            Some(default) => default,
            None => match read_if_there(sdo, supported).await? {
                Some(supported) if supported & SM_SYNCHRONOUS != 0 => with_data,
                // By that it shows whether it can be written.
                _ => held,
            },
        };
        match keeps(sdo, kind, wanted).await? {
            Some(Kept { value, .. }) if value == wanted && value != held => has_changed = true,
            // Not to be written: the drive takes it from elsewhere.
            None
            | Some(Kept {
                refused: Some(AbortCode::READ_ONLY),
                ..
            }) => {}
            Some(_) => {
                return Err(DriveFault::SyncLeft {
                    status,
                    index: kind.index(),
                    value: held,
                });
            }
        }
    }
    Ok(has_changed)
}

/// Whether a synchronisation type is one of the SYNC signals.
const fn asks_for_sync(kind: u16) -> bool {
    matches!(kind, WITH_SYNC0 | WITH_SYNC1)
}

/// Reads an object that the drive need not have.
async fn read_if_there<A: crate::coe::Readable>(
    sdo: &SdoHandle,
    object: Object<u16, A>,
) -> Result<Option<u16>, DriveFault> {
    match sdo.read(object).await {
        Ok(value) => Ok(Some(value)),
        Err(error) if error.error.abort_code().is_some() => Ok(None),
        Err(error) => Err(error.error.into()),
    }
}

/// What an object holds after something was written to it.
struct Kept<T> {
    value: T,
    refused: Option<AbortCode>,
}

/// Writes and reads back; nothing if the drive has no such object.
async fn keeps<T: crate::coe::Number>(
    sdo: &SdoHandle,
    object: Object<T, ReadWrite>,
    value: T,
) -> Result<Option<Kept<T>>, DriveFault> {
    let aborted = |error: &DriveError| error.error.abort_code();
    let refused = match sdo.write(object, value).await {
        Ok(()) => None,
        Err(error) => match aborted(&error) {
            Some(code) if code.is_no_object() => return Ok(None),
            Some(code) => Some(code),
            None => return Err(error.error.into()),
        },
    };
    match sdo.read(object).await {
        Ok(value) => Ok(Some(Kept { value, refused })),
        Err(error) if aborted(&error).is_some() => Ok(None),
        Err(error) => Err(error.error.into()),
    }
}

/// How long after that a drive has had as many pulses as at the start of a network, where all wait for the lock.
pub(super) fn settling(period: Duration) -> Duration {
    AHEAD + period * LOCK_CYCLES
}

/// Switches SYNC0 on, with its first pulse ahead. The clocks must have been set.
pub(super) async fn start_sync0(
    registers: &Registers,
    station: u16,
    position: u16,
    clocks: Option<&Rc<Clocks>>,
    clock: &DistributedClock,
    period: Duration,
) -> Result<(), DriveFault> {
    let clocks = clocks.ok_or(DriveFault::NoClock)?;
    let width = clocks.width(position).ok_or(DriveFault::NoClock)?;
    clocks.are_taught(registers.time()).await?;
    if clocks.stands() {
        return Err(DriveFault::ReferenceStands(clocks.reference.clone()));
    }
    let (sync0, sync1) = clock.cycles(period);
    let [control, activation] = clock.assign_activate.to_le_bytes();
    let ahead = u64::try_from(AHEAD.as_nanos()).unwrap_or(u64::MAX);
    for _ in 0..TRIES {
        registers.write(station, esc::SYNC_ACTIVATION, &[0]).await?;
        let (now, _) = clocks.now(registers).await?;
        let first = clock.first_pulse(now.saturating_add(ahead), period);
        write_time(registers, station, esc::SYNC0_START, first, width).await?;
        registers
            .write(station, esc::SYNC0_CYCLE, &sync0.to_le_bytes())
            .await?;
        registers
            .write(station, esc::SYNC1_CYCLE, &sync1.to_le_bytes())
            .await?;
        registers
            .write(station, esc::SYNC_CONTROL, &[control, activation])
            .await?;
        let [got] = registers.read(station, esc::SYNC_ACTIVATION).await?;
        if got != activation {
            return Err(DriveFault::SyncUnit {
                expected: activation,
                got,
            });
        }
        // A pulse that was to come in the past does not come for hundreds of years.
        let shown = read_time(registers, station, esc::SYSTEM_TIME, width).await?;
        if is_ahead(first, shown, width) {
            return Ok(());
        }
    }
    Err(DriveFault::Sync0Passed)
}

/// Whether a time is still to come on a clock that shows `now`.
fn is_ahead(time: u64, now: u64, width: Width) -> bool {
    match width {
        Width::Bits32 => (time as u32).wrapping_sub(now as u32).cast_signed() > 0,
        Width::Bits64 => time > now,
    }
}

// The way into the lock: cycles that begin in step with the reference clock, and OP only when they stay there.

/// How long the lock may take, beside as many cycles as it needs.
const LOCK_LIMIT: Duration = Duration::from_secs(2);
const LOCK_LIMIT_CYCLES: u32 = 500;

/// When the first cycle is to begin, and its phase.
pub(super) async fn first_cycle(
    context: &Context,
    clocks: &Clocks,
    period: Duration,
) -> Result<(Duration, Phase), NetworkError> {
    let now = clocks.now(&context.registers).await;
    let (time, at) = now.map_err(NetworkError::Line)?;
    let (phase, later) = Phase::starting_at(time, period);
    context.counters.clock.begin(bound(period));
    Ok((at + later, phase))
}

/// Waits until the cycles are in step, and until these drives' clocks are.
pub(super) async fn wait_for_lock(
    context: &Context,
    drives: impl Iterator<Item = &Found>,
    period: Duration,
) -> Result<(), NetworkError> {
    let started = context.time.now();
    let limit = LOCK_LIMIT + period * LOCK_LIMIT_CYCLES;
    let is_over = || context.time.now().saturating_sub(started) > limit;
    while let Some(seen) = context.counters.clock.read() {
        if seen.locked {
            let note = LogRecord::InStep {
                phase_error_ns: seen.phase_error_ns,
            };
            context.log.record(context.time.now(), note);
            break;
        }
        // From a jump there is no way back.
        if is_over() || seen.reference == ReferenceClock::Jumped {
            return Err(NetworkError::NotLocked {
                reference: seen.reference,
                phase_error_ns: seen.phase_error_ns,
                bound: seen.bound,
                after: context.time.now().saturating_sub(started),
            });
        }
        context.time.sleep(period).await;
    }
    for found in drives {
        while let Err(apart) = is_in_step(context, found, period).await {
            if is_over() {
                return Err(apart).at(BringUpStep::Clock).of(&found.id);
            }
            context.time.sleep(period).await;
        }
    }
    Ok(())
}

async fn is_in_step(context: &Context, found: &Found, period: Duration) -> Result<(), DriveFault> {
    let shown = context
        .registers
        .read(found.station, esc::SYSTEM_TIME_DIFFERENCE)
        .await?;
    // Bit 31 is the sign.
    let apart = Duration::from_nanos((u32::from_le_bytes(shown) & 0x7FFF_FFFF).into());
    let bound = bound(period);
    if apart > bound {
        return Err(DriveFault::ClockApart { apart, bound });
    }
    Ok(())
}

/// Tells what happens between the cycles and the reference clock once they were in step.
#[derive(Debug)]
pub(super) struct LockWatch {
    seen: (bool, ReferenceClock),
}

impl LockWatch {
    pub const fn new() -> Self {
        Self {
            seen: (true, ReferenceClock::Heard),
        }
    }

    /// What has happened since the look before.
    pub fn look(&mut self, clock: Option<ClockStatistics>) -> Option<ClockEvent> {
        use ReferenceClock::{Heard, Jumped, Silent};
        let ClockStatistics {
            phase_error_ns,
            locked,
            reference,
            ..
        } = clock?;
        let now = (locked, reference);
        let before = core::mem::replace(&mut self.seen, now);
        match (before, now) {
            _ if before == now => None,
            ((_, old), (_, new)) if old != new && new != Heard => Some(match new {
                Jumped => ClockEvent::Jumped {
                    by_ns: phase_error_ns,
                },
                _ => ClockEvent::Silent,
            }),
            (_, (true, Heard)) => Some(ClockEvent::InStep),
            ((true, _), (false, Heard)) => Some(ClockEvent::OutOfStep { phase_error_ns }),
            (_, (_, Heard | Silent | Jumped)) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn pulses_lie_on_the_grid_of_the_cycle_half_a_cycle_after_the_frames() {
        let clock = DistributedClock::new(0x0300);
        assert_eq!(clock.cycles(MS), (1_000_000, 0));
        assert_eq!(clock.first_pulse(7_200_000, MS), 7_500_000);
        assert_eq!(clock.first_pulse(7_500_000, MS), 7_500_000);
        assert_eq!(clock.first_pulse(7_500_001, MS), 8_500_000);
        let clock = clock.shift(MS / 4).sync0_cycle(2 * MS);
        assert_eq!(clock.cycles(MS), (2_000_000, 0));
        assert_eq!(clock.first_pulse(7_200_000, MS), 8_250_000);
        // A clock may show anything.
        assert_eq!(clock.first_pulse(u64::MAX, MS), u64::MAX);
    }

    #[test]
    fn each_mistake_has_its_words() {
        let clock = DistributedClock::new(0x0300);
        assert_eq!(clock.mistake(MS), None);
        assert_eq!(clock.sync0_cycle(MS / 4).mistake(MS), None);
        let both = DistributedClock::new(0x0700).sync1_after(MS / 4);
        assert_eq!(both.mistake(MS), None);
        for (clock, words) in [
            (DistributedClock::new(0), "0000h does not switch SYNC0 on"),
            (DistributedClock::new(0x0100), "0100h does not"),
            (clock.shift(MS), "not less than its cycle"),
            (clock.sync0_cycle(MS * 3 / 2), "neither a multiple"),
            (clock.sync0_cycle(Duration::ZERO), "not less than its cycle"),
            (clock.sync0_cycle(5_000 * MS), "no room"),
            (clock.sync1_after(MS / 4), "does not switch SYNC1 on"),
        ] {
            let mistake = clock.mistake(MS).unwrap();
            assert!(mistake.contains(words), "{mistake}");
        }
    }

    #[test]
    fn a_clock_of_32_bits_begins_again_and_its_times_are_still_ahead() {
        assert!(is_ahead(0x1_0000_0005, 0xFFFF_FFF0, Width::Bits32));
        assert!(!is_ahead(0xFFFF_FFF0, 5, Width::Bits32));
        assert!(is_ahead(6, 5, Width::Bits64));
        assert!(!is_ahead(5, 5, Width::Bits64));
    }

    #[test]
    fn each_change_is_told_once() {
        use ReferenceClock::{Heard, Jumped, Silent};
        let mut watch = LockWatch::new();
        let mut look = |locked, reference| {
            watch.look(Some(ClockStatistics {
                phase_error_ns: 7,
                locked,
                reference,
                ..ClockStatistics::default()
            }))
        };
        let out = Some(ClockEvent::OutOfStep { phase_error_ns: 7 });
        assert_eq!(look(true, Heard), None);
        assert_eq!(look(false, Heard), out);
        assert_eq!(look(false, Heard), None);
        assert_eq!(look(true, Heard), Some(ClockEvent::InStep));
        assert_eq!(look(true, Silent), Some(ClockEvent::Silent));
        assert_eq!(look(false, Silent), None);
        assert_eq!(look(false, Heard), None);
        assert_eq!(look(true, Heard), Some(ClockEvent::InStep));
        assert_eq!(look(false, Jumped), Some(ClockEvent::Jumped { by_ns: 7 }));
        assert_eq!(look(false, Jumped), None);
    }
}
