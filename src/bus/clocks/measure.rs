//! The clocks of a line before its drives are configured: receive times latched and read, delays and offsets written, and
//! the reference time given to all so often that each clock learns how fast its crystal is.

use std::{cell::Cell, rc::Rc, time::Duration};

use crate::{
    bus::{
        clocks::topology::{Latched, LatchedClock, Ports, Setting, Settings, Width, settings},
        cycle::reference_clock::{Distribution, SYSTEM_TIME, extend},
        error::{BringUpStep, DriveFault, NetworkError, RegisterError},
        line::{Found, loop_is_gone},
        requests::{Context, executor::Time, registers::Registers},
    },
    coe::DriveId,
};

/// ESC features.
const FEATURES: u16 = 0x0008;
const HAS_CLOCK: u16 = 1 << 2;
const CLOCK_OF_64_BITS: u16 = 1 << 3;
const DL_STATUS: u16 = 0x0110;
const RECEIVE_TIMES: u16 = 0x0900;
const RECEIVE_TIME_UNIT: u16 = 0x0918;
const OFFSET: u16 = 0x0920;
const DELAY: u16 = 0x0928;
/// A write resets the filters of a clock's control loop.
const SPEED_COUNTER_START: u16 = 0x0930;
/// How often the reference time is distributed at first. With the filter depth of a reset (0935h: 12) a clock averages its
/// deviation over 4096 of them: after these less than a thirtieth of it is left.
const DISTRIBUTIONS: u32 = 15_000;
const LOOK_EVERY: Duration = Duration::from_millis(1);
/// How often a latch that another one has overtaken is made again.
const LATCHES: usize = 5;

/// The clocks of a line after they were set.
#[derive(Debug)]
pub(in crate::bus) struct Clocks {
    pub(in crate::bus) distribution: Distribution,
    /// Whose clock is the reference.
    pub(in crate::bus) reference: DriveId,
    /// The width of each SubDevice's clock, by its place in the line.
    widths: Vec<Option<Width>>,
    /// Nanoseconds that a frame takes from the reference to each clock, by the same places.
    delays: Vec<Option<u32>>,
    /// A time of the reference clock, and when that was: later ones are extended to 64 bits with it.
    known: Cell<(u64, Duration)>,
    /// How the first distributions have ended.
    taught: Cell<Option<Result<(), RegisterError>>>,
    /// Whether the reference showed the same time before and after them.
    stands: Cell<bool>,
}

impl Clocks {
    /// The width of a SubDevice's clock; nothing where it has none.
    pub(in crate::bus) fn width(&self, position: u16) -> Option<Width> {
        self.widths.get(usize::from(position)).copied().flatten()
    }

    /// The reference clock's time as a frame passes it, and when that frame was back.
    pub(in crate::bus) async fn now(
        &self,
        registers: &Registers,
    ) -> Result<(u64, Duration), RegisterError> {
        let low = registers.read(self.distribution.station, SYSTEM_TIME);
        let low = u32::from_le_bytes(low.await?);
        let now = registers.time().now();
        let (time, at) = self.known.get();
        let since = u64::try_from(now.saturating_sub(at).as_nanos()).unwrap_or(u64::MAX);
        let known = (extend(time.wrapping_add(since), low), now);
        self.known.set(known);
        Ok(known)
    }

    /// Takes in a time of the reference that the cycles know, and when that was: by it later ones are extended.
    pub(in crate::bus) fn remember(&self, time: u64, at: Duration) {
        self.known.set((time, at));
    }

    /// Sets the clock of a SubDevice that has begun anew, where it was at the start, while all others run. The latch changes nothing of
    /// theirs, and neither do the distributions by which this one learns its speed: they get the time that the cycles bring them.
    pub(in crate::bus) async fn set_anew(
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
        // Of the reference, which has no offset.
        let reference = async || -> Result<u32, RegisterError> {
            let low = registers.read(self.distribution.station, RECEIVE_TIME_UNIT);
            low.await.map(u32::from_le_bytes)
        };
        for _ in 0..LATCHES {
            registers.broadcast(RECEIVE_TIMES, &[0; 4]).await?;
            let before = reference().await?;
            let local = read_local(registers, station, width).await?;
            let (now, _) = self.now(registers).await?;
            if reference().await? == before {
                return Ok(Some((extend(now, before), local)));
            }
        }
        Ok(None)
    }

    /// Distributes the reference time for the first time, while the drives are being configured.
    pub(in crate::bus) async fn teach(&self, registers: &Registers) {
        let result = self.distribute(registers).await;
        tracing::debug!(DISTRIBUTIONS, ?result, "the clocks know their speed");
        self.taught.set(Some(result));
    }

    async fn distribute(&self, registers: &Registers) -> Result<(), RegisterError> {
        let (before, _) = self.now(registers).await?;
        for _ in 0..DISTRIBUTIONS {
            registers
                .distribute(self.distribution.station, SYSTEM_TIME)
                .await?;
        }
        let (after, _) = self.now(registers).await?;
        self.stands.set(before as u32 == after as u32);
        Ok(())
    }

    /// Whether the reference clock does not run.
    pub(in crate::bus) fn stands(&self) -> bool {
        self.stands.get()
    }

    /// Waits until that is over.
    pub(in crate::bus) async fn are_taught(&self, time: &Rc<Time>) -> Result<(), RegisterError> {
        loop {
            if let Some(result) = self.taught.get() {
                return result;
            }
            time.sleep(LOOK_EVERY).await;
        }
    }
}

/// Sets the clocks of all SubDevices; the first one is the reference. Nothing if there is none.
pub(in crate::bus) async fn measure(
    context: &Context,
    line: &[Found],
) -> Result<Option<Rc<Clocks>>, NetworkError> {
    let registers = &context.registers;
    registers
        .broadcast(RECEIVE_TIMES, &[0; 4])
        .await
        .map_err(NetworkError::Line)?;
    let stations = || line.iter().map(|found| found.station);
    let latched = stations().map(|station| read_latched(registers.clone(), station));
    let latched = all(context, line, latched).await?;
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
    let widths = latched
        .iter()
        .map(|latched| Some(latched.clock?.width))
        .collect::<Vec<_>>();
    let clocks = widths.iter().flatten().count();
    let delays: Vec<_> = settings
        .iter()
        .map(|set| Some(set.as_ref()?.delay))
        .collect();
    tracing::info!(reference = %first.id, clocks, ?delays, "distributed clocks are set");
    Ok(Some(Rc::new(Clocks {
        distribution: Distribution {
            station: first.station,
        },
        reference: first.id.clone(),
        widths,
        delays,
        known: Cell::new((clock.local, registers.time().now())),
        taught: Cell::new(None),
        stands: Cell::new(false),
    })))
}

async fn read_latched(registers: Registers, station: u16) -> Result<Latched, RegisterError> {
    let features = u16::from_le_bytes(registers.read(station, FEATURES).await?);
    let ports = u16::from_le_bytes(registers.read(station, DL_STATUS).await?);
    let width = match features & (HAS_CLOCK | CLOCK_OF_64_BITS) {
        bits if bits & HAS_CLOCK == 0 => None,
        HAS_CLOCK => Some(Width::Bits32),
        _ => Some(Width::Bits64),
    };
    let clock = match width {
        None => None,
        Some(width) => {
            let times: [u8; 16] = registers.read(station, RECEIVE_TIMES).await?;
            let mut received = [0; 4];
            for (time, bytes) in received.iter_mut().zip(times.as_chunks().0) {
                *time = u32::from_le_bytes(*bytes);
            }
            let local = read_local(&registers, station, width).await?;
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

/// The local time at which the latched frame came.
async fn read_local(
    registers: &Registers,
    station: u16,
    width: Width,
) -> Result<u64, RegisterError> {
    Ok(match width {
        Width::Bits32 => {
            u32::from_le_bytes(registers.read(station, RECEIVE_TIME_UNIT).await?).into()
        }
        Width::Bits64 => u64::from_le_bytes(registers.read(station, RECEIVE_TIME_UNIT).await?),
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
    write_time(registers, station, OFFSET, setting.offset, width).await?;
    let delay = setting.delay.to_le_bytes();
    registers.write(station, DELAY, &delay).await?;
    // What the filters hold is of the time before.
    let start: [u8; 2] = registers.read(station, SPEED_COUNTER_START).await?;
    registers.write(station, SPEED_COUNTER_START, &start).await
}

/// Writes a time, or the lower half to a clock that has no more.
pub(in crate::bus) async fn write_time(
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
        results.push(result.map_err(|error| {
            found
                .clone()
                .fault(BringUpStep::Clock, DriveFault::from(error))
        })?);
    }
    Ok(results)
}
