//! Which devices are on the line: from power-on to PREOP, all SubDevices at once, and where a device is that was without power.
//!
//! It owns the station addresses. It calls `requests`, and must not configure a device: that is `device`.

use std::{rc::Rc, sync::Arc, time::Duration};

use super::{
    error::{
        AlError, AlState, AlStatus, AtStep, BringUpStep, DriveFault, NetworkError, OfDevice,
        RegisterError, StepError,
    },
    expected::{DevicePlace, Expected, LineMismatch, LineRow, LineVerdict, Present},
    log::LogRecord,
    requests::{
        Context,
        eeprom::{self, SiiBytes},
        registers::{self, Registers},
        sync_managers,
    },
};
use crate::{
    coe::DriveId,
    esc,
    sii::{Identity, Sii},
};

/// The station address of the first SubDevice; the others follow.
const FIRST_STATION: u16 = 0x1000;
/// The most SubDevices of a line: the stations 1000h to 1FFFh. A working counter that says more is wrong, and would cost
/// memory and minutes for each SubDevice that is not there.
const MOST_SUB_DEVICES: u16 = 0x1000;
/// How long a SubDevice may take into INIT, and into PREOP (ETG.1020, default timeouts).
const INIT_LIMIT: Duration = Duration::from_secs(5);
const PRE_OP_LIMIT: Duration = Duration::from_secs(3);

const COMMUNICATION: u16 = 0x0200;
/// How far apart two counts are that must agree: a port that was opened needs its time.
const STEADY_FOR: Duration = Duration::from_millis(20);
/// How often a line is reset that has become longer or shorter meanwhile.
const MOST_RESETS: usize = 50;

/// What every SubDevice is set back to in INIT: register, and how many zeros. In pieces of one FMMU or sync manager, since
/// some ESCs have less of them and refuse a write beyond. Besides: event mask, EEPROM to the master, and of the distributed
/// clock the cyclic unit, start and cycle times.
const ZEROS: [(u16, usize); 6] = [
    (esc::EVENT_MASK, 2),
    (esc::EEPROM_CONFIGURATION, 1),
    (esc::SYNC_ACTIVATION, 1),
    (esc::SYNC0_START, 8),
    (esc::SYNC0_CYCLE, 4),
    (esc::SYNC1_CYCLE, 4),
];
/// And its system time, where no line runs: others may follow it.
const TIME_ZEROS: [(u16, usize); 2] = [(esc::SYSTEM_TIME_OFFSET, 8), (esc::SYSTEM_TIME_DELAY, 4)];
/// Of each, an ESC has at most 16.
const MOST: u16 = 16;

/// A SubDevice of the line, in INIT when it is found.
#[derive(Debug, Clone)]
pub(in crate::bus) struct Found {
    pub station: u16,
    pub id: DriveId,
    /// What configuration needs of its SII, or all of it.
    pub sii: Rc<Sii>,
    /// What was read of that.
    bytes: SiiBytes,
}

impl Found {
    /// A device that is not in the line: nothing is known of it but what is expected.
    pub fn absent(id: DriveId) -> Self {
        Self {
            station: KnownLine::station_of(id.position.into()),
            id,
            sii: Rc::new(Sii::default()),
            bytes: SiiBytes::new(),
        }
    }

    /// Notes how far its set-up is.
    pub fn note(&self, context: &Context, what: &'static str) {
        let note = LogRecord::SetUp(Arc::new(self.id.clone()), what);
        context.log.record(context.time.now(), note);
    }

    /// Numbers the devices of a line in INIT anew, so that those of optional groups come behind the others. `members` says of each which
    /// member of the groups it is, in their order; of several for one, only the first gets its address. The others, and all in the order in
    /// which frames reach them.
    pub async fn number_apart(
        registers: &Registers,
        mut physical: Vec<Self>,
        members: &[Option<usize>],
    ) -> Result<(Vec<Self>, Vec<Self>), NetworkError> {
        let lasting = members.iter().filter(|member| member.is_none()).count();
        let mut places = 0..lasting;
        let numbers: Vec<_> = members
            .iter()
            .enumerate()
            .map(|(at, member)| match member {
                None => places.next(),
                Some(_) if members.iter().take(at).any(|before| before == member) => None,
                Some(member) => Some(lasting + member),
            })
            .collect();
        // Those that come and go first, out of the way of the others, and at last with their own.
        let is_optional = |number: &Option<usize>| number.is_none_or(|number| number >= lasting);
        for (found, (number, at)) in physical.iter_mut().zip(numbers.iter().zip(PROVISIONAL..)) {
            if is_optional(number) {
                found.rename(registers, number.map_or(0, |_| at)).await?;
            }
        }
        for is_last in [false, true] {
            for (found, number) in physical.iter_mut().zip(&numbers) {
                if let Some(number) = number.filter(|_| is_optional(number) == is_last) {
                    found.id.position = to_position(number);
                    found
                        .rename(registers, KnownLine::station_of(number))
                        .await?;
                }
            }
        }
        let mut kept = numbers.iter();
        physical.retain(|_| kept.next().is_some_and(Option::is_some));
        let last = |found: &&Self| usize::from(found.id.position) < lasting;
        let line = physical.iter().filter(last).cloned().collect();
        Ok((line, physical))
    }

    /// It is in the line now, with its address, and is led into INIT.
    pub async fn meet(&self, context: &Context) -> Result<Self, NetworkError> {
        find(context.clone(), self.id.position, self.station).await
    }

    /// Gives it another address.
    async fn rename(&mut self, registers: &Registers, station: u16) -> Result<(), NetworkError> {
        if station != self.station {
            let named = give_name(registers, self.station, station).await;
            named.map_err(NetworkError::Line)?;
            self.station = station;
        }
        Ok(())
    }

    /// Reads what is left of its SII. In INIT: from PREOP on it belongs to the device.
    pub async fn read_whole_sii(&mut self, registers: &Registers) -> Result<(), StepError> {
        let sii = eeprom::read_whole(registers, self.station, &mut self.bytes)
            .await
            .at(BringUpStep::Sii)?;
        self.sii = Rc::new(sii);
        Ok(())
    }

    /// The device that stands in its place now, in INIT, by its station address.
    pub async fn successor(&self, registers: &Registers) -> Result<Self, StepError> {
        let place = (self.id.position, self.station);
        let (found, _) = Self::identify(registers, place).await?;
        Ok(found)
    }

    /// Reads who it is, and what configuration needs of its SII. Whether its EEPROM was taken from its processor for that.
    async fn identify(
        registers: &Registers,
        (position, station): (u16, u16),
    ) -> Result<(Self, bool), StepError> {
        let step = BringUpStep::Sii;
        let is_forced = eeprom::take_over(registers, station).await.at(step)?;
        let mut bytes = SiiBytes::new();
        let read = eeprom::read(registers, station, &mut bytes).await;
        let (sii, name) = read.at(step)?;
        let id = DriveId {
            position,
            name,
            identity: sii.identity,
        };
        let found = Self {
            station,
            id,
            sii: Rc::new(sii),
            bytes,
        };
        Ok((found, is_forced))
    }

    /// From INIT to PREOP: the device gets its EEPROM, and the sync managers of its mailbox.
    pub async fn enter_pre_op(&self, registers: &Registers) -> Result<(), StepError> {
        let step = BringUpStep::State(AlState::PreOp);
        eeprom::give_away(registers, self.station).await.at(step)?;
        sync_managers::set_mailbox(registers, self.station, &self.sii)
            .await
            .at(step)?;
        registers::request(registers, self.station, AlState::PreOp, PRE_OP_LIMIT)
            .await
            .at(step)
    }
}

/// Finds all SubDevices and brings them into INIT.
pub(in crate::bus) async fn discover(context: &Context) -> Result<Vec<Found>, NetworkError> {
    discover_each(context, None).await?.into_iter().collect()
}

/// The numbers that a device shows which was declared by one of these, as far as any of them needs it.
pub(in crate::bus) async fn numbers(
    registers: &Registers,
    station: u16,
    places: &[DevicePlace],
) -> Result<Vec<DevicePlace>, RegisterError> {
    let mut numbers = Vec::new();
    let has = |place: fn(&DevicePlace) -> bool| places.iter().any(place);
    if has(|place| matches!(place, DevicePlace::Alias(_))) {
        let alias = registers.read(station, esc::STATION_ALIAS).await?;
        numbers.push(DevicePlace::Alias(u16::from_le_bytes(alias)));
    }
    if has(|place| matches!(place, DevicePlace::Identification(_))) {
        let id = registers.identification(station).await?;
        numbers.extend(id.map(DevicePlace::Identification));
    }
    for place in places {
        let &DevicePlace::IdentificationAt { register, .. } = place else {
            continue;
        };
        match registers
            .read(station, register)
            .await
            .map(u16::from_le_bytes)
        {
            Ok(id) => numbers.push(DevicePlace::IdentificationAt { register, id }),
            // It has no such register.
            Err(RegisterError::NotAnswered) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(numbers)
}

/// Brings these SubDevices into PREOP.
pub(in crate::bus) async fn enter_pre_op(
    context: &Context,
    line: &[Found],
) -> Result<(), NetworkError> {
    let tasks = line.iter().cloned().map(|found| {
        let registers = context.registers.clone();
        context.spawn(async move { found.enter_pre_op(&registers).await.of(&found.id) })
    });
    let tasks: Option<Vec<_>> = tasks.collect();
    for task in tasks.ok_or_else(loop_is_gone)? {
        task.await?;
    }
    Ok(())
}

/// How many SubDevices there are: at least one, and not more than have an address.
async fn count(registers: &Registers) -> Result<u16, NetworkError> {
    match registers.count().await {
        Ok(0) | Err(RegisterError::NotAnswered) => Err(NetworkError::NoSubDevice),
        Ok(count) if count > MOST_SUB_DEVICES => Err(NetworkError::TooManySubDevices {
            most: MOST_SUB_DEVICES,
            got: count,
        }),
        Ok(count) => Ok(count),
        Err(RegisterError::NoFrame) => Err(NetworkError::NoAnswer),
        Err(error) => Err(NetworkError::Line(error)),
    }
}

/// Finds all SubDevices and brings each into INIT, as far as it comes; `seen` gets the AL states in which they were found.
pub(in crate::bus) async fn discover_each(
    context: &Context,
    mut seen: Option<&mut Vec<AlStatus>>,
) -> Result<Vec<Result<Found, NetworkError>>, NetworkError> {
    let registers = &context.registers;
    let mut counts = (0, count(registers).await?);
    let mut ring = None;
    for _ in 0..MOST_RESETS {
        let (_, there) = counts;
        if let Some(seen) = seen.as_deref_mut() {
            seen.truncate(there.into());
            for position in (0..there).skip(seen.len()) {
                let status = registers::status_at(registers, position).await;
                seen.push(status.map_err(NetworkError::Line)?);
            }
        }
        reset(context).await?;
        counts = (there, count(registers).await?);
        // Those that a port had kept away were not reset.
        if counts.0 != counts.1 {
            continue;
        }
        let counted = context.time.now();
        let line = in_init(context, there).await;
        context.prepare_link().await?;
        let since = context.time.now().saturating_sub(counted);
        context.time.sleep(STEADY_FOR.saturating_sub(since)).await;
        counts = (there, count(registers).await?);
        if counts.0 != counts.1 {
            continue;
        }
        match second_port(registers, there).await? {
            None => return line,
            // A damaged read can show it as well, and a device that appears after the last count.
            port if ring != port => ring = port,
            Some(port) => {
                let position = there.saturating_sub(1);
                return Err(NetworkError::Ring { position, port });
            }
        }
    }
    let (before, now) = counts;
    Err(NetworkError::UnsteadyLine { before, now })
}

/// The port by which the last SubDevice leads on, if it does: the way of a frame ends at a device that has one open port.
async fn second_port(registers: &Registers, count: u16) -> Result<Option<u8>, NetworkError> {
    let position = count.saturating_sub(1);
    let status = registers.read_at(position, esc::DL_STATUS).await;
    let status = u16::from_le_bytes(status.map_err(NetworkError::Line)?);
    let mut open = (0..4).filter(|port| status & (COMMUNICATION << (2 * port)) != 0);
    Ok(open.nth(1))
}

/// Gives `count` SubDevices their addresses, and reads who they are.
async fn in_init(
    context: &Context,
    count: u16,
) -> Result<Vec<Result<Found, NetworkError>>, NetworkError> {
    // All addresses before anything else: a SubDevice that kept one from before must not answer to another's.
    let stations = (0..count).map(|position| (position, FIRST_STATION.wrapping_add(position)));
    let addresses = stations.clone().map(|(position, station)| {
        let registers = context.registers.clone();
        async move {
            let station = station.to_le_bytes();
            registers
                .write_at(position, esc::STATION_ADDRESS, &station)
                .await
        }
    });
    all(context, addresses).await?;
    let tasks: Option<Vec<_>> = stations
        .map(|(position, station)| context.spawn(find(context.clone(), position, station)))
        .collect();
    let mut line = Vec::new();
    for task in tasks.ok_or_else(loop_is_gone)? {
        line.push(task.await);
    }
    Ok(line)
}

/// Brings all SubDevices into INIT, whatever they were doing, with nothing configured. First of all each answers to its own address
/// alone, and when they have stopped, the ports that an earlier program may have closed are open again.
async fn reset(context: &Context) -> Result<(), NetworkError> {
    let registers = &context.registers;
    for (register, bytes) in [
        (esc::ALIAS_ADDRESSING, &[0][..]),
        (esc::AL_CONTROL, &registers::RESET),
        (esc::PORTS, &[0]),
    ] {
        registers
            .broadcast(register, bytes)
            .await
            .map_err(NetworkError::Line)?;
    }
    let zeros = zeros().chain(TIME_ZEROS).map(|(register, zeros)| {
        let registers = registers.clone();
        async move {
            let bytes = [0; 16];
            let bytes = bytes.get(..zeros).unwrap_or(&bytes);
            registers.broadcast(register, bytes).await
        }
    });
    all(context, zeros).await
}

/// Sets one SubDevice back into INIT, with nothing configured. Its clock goes on, which may be the reference of a line that runs.
pub(in crate::bus) async fn set_back(registers: &Registers, station: u16) -> Result<(), AlError> {
    registers
        .write(station, esc::AL_CONTROL, &registers::RESET)
        .await?;
    registers::reach(registers, station, AlState::Init, INIT_LIMIT).await?;
    for (register, zeros) in zeros() {
        let bytes = [0; 16];
        let bytes = bytes.get(..zeros).unwrap_or(&bytes);
        match registers.write(station, register, bytes).await {
            // It has no such register.
            Ok(()) | Err(RegisterError::NotAnswered) => {}
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
}

/// The registers that are set back, each with its length.
fn zeros() -> impl Iterator<Item = (u16, usize)> {
    let fmmus = (0..MOST).map(|fmmu| (esc::FMMU + 16 * fmmu, 16));
    let managers = (0..MOST).map(|manager| (esc::SYNC_MANAGER + 8 * manager, 8));
    fmmus.chain(managers).chain(ZEROS)
}

/// Waits for all of these, which are under way at the same time.
async fn all<F>(context: &Context, accesses: impl Iterator<Item = F>) -> Result<(), NetworkError>
where
    F: Future<Output = Result<(), RegisterError>> + 'static,
{
    let tasks: Option<Vec<_>> = accesses.map(|access| context.spawn(access)).collect();
    for task in tasks.ok_or_else(loop_is_gone)? {
        task.await.map_err(NetworkError::Line)?;
    }
    Ok(())
}

pub(in crate::bus) fn loop_is_gone() -> NetworkError {
    NetworkError::Thread("the bus loop is gone".into())
}

/// One SubDevice in INIT: who it is, and what configuration needs of its SII.
async fn find(context: Context, position: u16, station: u16) -> Result<Found, NetworkError> {
    let registers = &context.registers;
    let unknown = DriveId {
        position,
        name: String::new(),
        identity: Identity::default(),
    };
    let steps = async {
        registers::reach(registers, station, AlState::Init, INIT_LIMIT)
            .await
            .at(BringUpStep::State(AlState::Init))?;
        Found::identify(registers, (position, station)).await
    };
    let (found, is_forced) = steps.await.of(&unknown)?;
    if is_forced {
        let note = LogRecord::EepromForced(Arc::new(found.id.clone()));
        context.log.record(context.time.now(), note);
    }
    Ok(found)
}

// Where in the line a device is that was without power: it has lost its station address, and others may be missing.
//
// What is left of a line has the order that it had. Devices that have kept their address are known by it; for the others the
// identity decides, down to the serial number, and the order where several are alike.
//
// A device without an address can only be reached by its position, and that changes when another one comes or goes. So there is one
// access by position: it gives a provisional address. Should that reach a device that runs, because the line has changed, the device
// gets its own address back.

/// The first of the station addresses that nameless devices have while it is looked who they are: behind those of a line.
const PROVISIONAL: u16 = 0x2000;
/// How often the line is looked at again when it has changed meanwhile, or a frame was lost, and how long after.
const TRIES: usize = 100;

/// A device of the line as it is now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Seen {
    /// Its address, which may be a provisional one.
    station: u16,
    who: FoundAs,
}

impl Seen {
    /// Whether it may come and go, where so many do not.
    const fn is_optional(&self, lasting: usize) -> bool {
        match self.who {
            FoundAs::Known(number) => number >= lasting,
            FoundAs::Nameless { .. } => false,
            FoundAs::Optional { .. } => true,
        }
    }
}

/// Which device of the line, if any.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FoundAs {
    /// It has kept its address: this is its place at the start.
    Known(usize),
    /// It has none of the line's, and is this one. After a power loss it is in INIT; otherwise it runs.
    Nameless { identity: Identity, runs: bool },
    /// The same, and it says that it is one of those that may come and go.
    Optional { identity: Identity },
}

/// The devices of a line, as they were numbered at the start.
#[derive(Clone)]
pub(in crate::bus) struct KnownLine {
    /// Those that last.
    pub devices: Vec<DriveId>,
    /// How those are declared that may come and go. They are numbered behind the others, and have the addresses behind theirs.
    pub optional: Vec<DevicePlace>,
}

impl KnownLine {
    fn identities(&self) -> Vec<Identity> {
        self.devices.iter().map(|device| device.identity).collect()
    }

    /// So many addresses are given to its devices.
    const fn addresses(&self) -> usize {
        self.devices.len() + self.optional.len()
    }

    /// Whether one that comes and goes has this number.
    const fn is_optional(&self, place: usize) -> bool {
        place >= self.devices.len()
    }

    /// The address that a device has with this number.
    pub fn station_of(place: usize) -> u16 {
        FIRST_STATION.wrapping_add(to_position(place))
    }

    /// Gives the device that had this place at the start its station address again; tells where it is now, where those that come and go are
    /// not counted. Where a serial number is accepted, that is the one of its kind that has this number.
    pub async fn find_again(
        &self,
        registers: &Registers,
        wanted: &DriveId,
        accepted: Option<u32>,
    ) -> Result<u16, NetworkError> {
        let mut last = RegisterError::NotAnswered;
        for _ in 0..TRIES {
            match find_once(registers, self, wanted, accepted).await {
                Ok(Some(verdict)) => return verdict,
                Ok(None) => {}
                // What was begun is brought to its end.
                Err(lost) => last = lost,
            }
            registers.time().sleep(STEADY_FOR).await;
        }
        Err(NetworkError::Drive {
            drive: wanted.clone(),
            step: BringUpStep::Identity,
            error: Box::new(DriveFault::Register(last)),
        })
    }

    /// Whether two devices have one address: one of them has it from another line.
    pub async fn has_namesakes(registers: &Registers) -> Result<bool, RegisterError> {
        let mut stations = stations_on_the_line(registers).await?;
        stations.retain(|station| *station != 0);
        let many = stations.len();
        stations.sort_unstable();
        stations.dedup();
        Ok(stations.len() < many)
    }

    /// Where the device with this address is now, where those that come and go are not counted.
    pub async fn place_of(
        &self,
        registers: &Registers,
        station: u16,
    ) -> Result<Option<u16>, RegisterError> {
        let stations = stations_on_the_line(registers).await?;
        let is_optional = |station: &u16| {
            place_at_start(*station, self.addresses()).is_some_and(|place| self.is_optional(place))
        };
        let mut lasting = stations.iter().filter(|station| !is_optional(station));
        let place = lasting.position(|seen| *seen == station);
        Ok(place.map(to_position))
    }

    /// Looks at the line once, and lets `named` say which of the devices that are not in use get which addresses. What it says; none where
    /// the line has changed meanwhile.
    pub async fn name_new_ones<T>(
        &self,
        registers: &Registers,
        is_in_use: impl Fn(usize) -> bool,
        named: impl FnOnce(&[NewDevice]) -> (Vec<(usize, u16)>, T),
    ) -> Result<Option<T>, RegisterError> {
        let Some(seen) = look(registers, self).await? else {
            return Ok(None);
        };
        let mut new = Vec::new();
        for (at, seen) in seen.iter().enumerate() {
            let (identity, is_known) = match seen.who {
                FoundAs::Known(number) if is_in_use(number) => continue,
                FoundAs::Known(_) => {
                    // With its power it has kept its address, its state and its error.
                    let init = &registers::RESET;
                    registers.write(seen.station, esc::AL_CONTROL, init).await?;
                    let identity = eeprom::identity(registers, seen.station).await;
                    (identity.unwrap_or_default(), true)
                }
                FoundAs::Nameless { runs: true, .. } => continue,
                FoundAs::Nameless { identity, .. } | FoundAs::Optional { identity } => {
                    (identity, false)
                }
            };
            let present = present(registers, (at, seen.station), identity, &self.optional).await?;
            let station = is_known.then_some(seen.station);
            new.push(NewDevice { present, station });
        }
        let (named, result) = named(&new);
        let at = |number: usize| {
            new.get(number)
                .map(|device| usize::from(device.present.id.position))
        };
        let named: Vec<_> = named
            .into_iter()
            .filter_map(|(number, station)| Some((at(number)?, station)))
            .collect();
        settle(registers, &self.identities(), &seen, &named).await?;
        Ok(Some(result))
    }
}

async fn find_once(
    registers: &Registers,
    line: &KnownLine,
    wanted: &DriveId,
    accepted: Option<u32>,
) -> Result<Option<Result<u16, NetworkError>>, RegisterError> {
    let Some(seen) = look(registers, line).await? else {
        return Ok(None);
    };
    let own = KnownLine::station_of(wanted.position.into());
    let wanted = match accepted {
        Some(serial) => &in_place_of(wanted, serial, &seen),
        None => wanted,
    };
    let mut expected = line.identities();
    if let Some(identity) = expected.get_mut(usize::from(wanted.position)) {
        *identity = wanted.identity;
    }
    // It has its address again where only the answer to that was lost.
    let chosen = match seen.iter().position(|seen| seen.station == own) {
        Some(at) => Ok(at),
        None => choose(&expected, wanted, &seen),
    };
    let named = chosen.as_ref().ok().map(|at| (*at, own));
    settle(registers, &expected, &seen, named.as_slice()).await?;
    let lasting = |seen: &&Seen| !seen.is_optional(line.devices.len());
    Ok(Some(chosen.map(|at| {
        to_position(seen.iter().take(at).filter(lasting).count())
    })))
}

/// A device that is not in use.
pub(in crate::bus) struct NewDevice {
    pub present: Present,
    /// Its address, where it is one of those that come and go, and has kept it.
    pub station: Option<u16>,
}

/// One look at the line: who is there, in their order. Those without an address of the line have a provisional one. None where it has
/// changed meanwhile.
async fn look(registers: &Registers, line: &KnownLine) -> Result<Option<Vec<Seen>>, RegisterError> {
    let Some(stations) = give_provisional(registers, line.addresses()).await? else {
        return Ok(None);
    };
    let Some(seen) = identify(registers, &stations, line).await? else {
        return Ok(None);
    };
    // Who came or went meanwhile has moved the positions.
    let is_steady = stations_on_the_line(registers).await? == stations;
    Ok(is_steady.then_some(seen))
}

/// Takes the provisional addresses away again: these devices get those, and who runs gets its own.
async fn settle(
    registers: &Registers,
    line: &[Identity],
    seen: &[Seen],
    named: &[(usize, u16)],
) -> Result<(), RegisterError> {
    for (at, Seen { station, who }) in seen.iter().enumerate() {
        let runs = match *who {
            FoundAs::Known(_) => continue,
            FoundAs::Nameless { runs, .. } => runs,
            FoundAs::Optional { .. } => false,
        };
        if named.iter().any(|(named, _)| *named == at) {
            continue;
        }
        let is_there = |place: &usize| candidates(line, *place, seen) == [(at, false)];
        match (0..line.len()).find(is_there) {
            _ if !runs => give_name(registers, *station, 0).await?,
            // A provisional address has taken the place of its own.
            Some(place) => {
                eeprom::give_away(registers, *station).await?;
                give_name(registers, *station, KnownLine::station_of(place)).await?;
            }
            None => {}
        }
    }
    for (at, own) in named {
        if let Some(seen) = seen.get(*at).filter(|seen| seen.station != *own) {
            give_name(registers, seen.station, *own).await?;
        }
    }
    Ok(())
}

/// Which place a device had at the start, if this address is one of the line's.
fn place_at_start(station: u16, at_start: usize) -> Option<usize> {
    let place = station.checked_sub(FIRST_STATION).map(usize::from);
    place.filter(|place| *place < at_start)
}

/// The address of each device that is there.
async fn stations_on_the_line(registers: &Registers) -> Result<Vec<u16>, RegisterError> {
    let mut stations = Vec::new();
    for position in 0..registers.count().await? {
        match registers.read_at(position, esc::STATION_ADDRESS).await {
            Ok(station) => stations.push(u16::from_le_bytes(station)),
            // It was there when they were counted.
            Err(RegisterError::NotAnswered) => break,
            Err(error) => return Err(error),
        }
    }
    Ok(stations)
}

/// Gives each device that has no address of the line one for now: those of all devices that are there. None where the line has
/// changed meanwhile.
async fn give_provisional(
    registers: &Registers,
    at_start: usize,
) -> Result<Option<Vec<u16>>, RegisterError> {
    let mut stations = stations_on_the_line(registers).await?;
    for position in 0..stations.len() {
        let Some(before) = stations.get(position).copied() else {
            break;
        };
        if place_at_start(before, at_start).is_some() {
            continue;
        }
        let free = |station: &u16| !stations.contains(station);
        let Some(station) = (PROVISIONAL..).find(free) else {
            break;
        };
        let place = to_position(position);
        let shown = registers.read_at(place, esc::STATION_ADDRESS).await?;
        if u16::from_le_bytes(shown) != before {
            return Ok(None);
        }
        let address = station.to_le_bytes();
        registers
            .write_at(place, esc::STATION_ADDRESS, &address)
            .await?;
        if let Some(known) = stations.get_mut(position) {
            *known = station;
        }
    }
    Ok(Some(stations))
}

/// Gives the device that has this address another one.
async fn give_name(registers: &Registers, station: u16, name: u16) -> Result<(), RegisterError> {
    let name = name.to_le_bytes();
    registers.write(station, esc::STATION_ADDRESS, &name).await
}

/// Asks those without an address of the line who they are, and whether they run. None where one does not say who it is, and runs.
async fn identify(
    registers: &Registers,
    stations: &[u16],
    line: &KnownLine,
) -> Result<Option<Vec<Seen>>, RegisterError> {
    let mut seen = Vec::with_capacity(stations.len());
    for (at, &station) in stations.iter().enumerate() {
        let who = match place_at_start(station, line.addresses()) {
            Some(place) => FoundAs::Known(place),
            None => {
                let status = registers::status(registers, station).await?;
                let runs = status.state != AlState::Init;
                let identity = eeprom::identity(registers, station).await;
                if runs && identity.is_err() {
                    return Ok(None);
                }
                // One that cannot be read is none of the line's.
                let identity = identity.unwrap_or_default();
                let present = present(registers, (at, station), identity, &line.optional).await?;
                if line.optional.iter().any(|place| present.says(*place)) {
                    FoundAs::Optional { identity }
                } else {
                    FoundAs::Nameless { identity, runs }
                }
            }
        };
        seen.push(Seen { station, who });
    }
    Ok(Some(seen))
}

async fn present(
    registers: &Registers,
    (at, station): (usize, u16),
    identity: Identity,
    places: &[DevicePlace],
) -> Result<Present, RegisterError> {
    let id = DriveId {
        position: to_position(at),
        name: String::new(),
        identity,
    };
    let numbers = numbers(registers, station, places).await?;
    Ok(Present { id, numbers })
}

/// Who is wanted in place of a device: one of its kind with this serial number. Of which revision, the device that is there says; whoever
/// accepts it judges that.
fn in_place_of(device: &DriveId, serial: u32, seen: &[Seen]) -> DriveId {
    let wanted = Identity {
        serial,
        ..device.identity
    };
    let is_wanted = |identity: &Identity| {
        let revision = wanted.revision;
        Identity {
            revision,
            ..*identity
        } == wanted
    };
    let there = seen.iter().find_map(|seen| match seen.who {
        FoundAs::Nameless { identity, .. } if is_wanted(&identity) => Some(identity),
        _ => None,
    });
    DriveId {
        identity: there.unwrap_or(wanted),
        ..device.clone()
    }
}

/// Which of the devices that are there is the wanted one.
fn choose(expected: &[Identity], wanted: &DriveId, seen: &[Seen]) -> Result<usize, NetworkError> {
    let declared = DevicePlace::Position(wanted.position);
    let place = usize::from(wanted.position);
    let candidates = candidates(expected, place, seen);
    let verdict = match candidates.as_slice() {
        &[(only, false)] => return Ok(only),
        [] => {
            let mut behind = seen.iter().enumerate().filter(|(_, seen)| match seen.who {
                FoundAs::Known(known) => known < place,
                FoundAs::Nameless { .. } | FoundAs::Optional { .. } => false,
            });
            // What stands where it would be the next one.
            let from = behind.next_back().map_or(0, |(at, _)| at + 1);
            let mut next = seen.iter().enumerate().skip(from);
            let next = next.find(|(_, seen)| !seen.is_optional(expected.len()));
            match next.map(|(at, seen)| (at, seen.who)) {
                Some((at, FoundAs::Nameless { identity, .. })) if identity != wanted.identity => {
                    let id = DriveId {
                        position: to_position(at),
                        name: String::new(),
                        identity,
                    };
                    let numbers = Vec::new();
                    let found = Some(Present { id, numbers });
                    return Err(mismatch(declared, wanted, found, LineVerdict::Different));
                }
                _ => LineVerdict::Missing,
            }
        }
        several => LineVerdict::NotUnique {
            positions: several.iter().map(|(at, _)| to_position(*at)).collect(),
        },
    };
    Err(mismatch(declared, wanted, None, verdict))
}

/// The table of a line of which only the wanted device is looked at, which was declared so.
pub(super) fn mismatch(
    place: DevicePlace,
    wanted: &DriveId,
    found: Option<Present>,
    verdict: LineVerdict,
) -> NetworkError {
    let Identity {
        vendor,
        product,
        revision,
        serial,
    } = wanted.identity;
    let expected = Expected::new(vendor, product).revision(revision);
    let expected = expected.serial(serial).named(wanted.name.clone());
    NetworkError::WrongLine(LineMismatch(vec![LineRow {
        position: Some(wanted.position),
        expected: Some((place, expected)),
        found,
        verdict,
    }]))
}

/// The nameless devices that can be the one that had this place, if what is there is a part of the line in its order; each
/// with whether it can be that of another place as well. Devices that no place of the line had are left out.
fn candidates(line: &[Identity], place: usize, seen: &[Seen]) -> Vec<(usize, bool)> {
    let own: Vec<_> = seen
        .iter()
        .enumerate()
        .map(|(at, seen)| (at, &seen.who))
        .filter(|(_, who)| line.iter().enumerate().any(|(at, is)| who.is(at, is)))
        .collect();
    let others = || (0..line.len()).filter(|other| *other != place);
    (0..own.len())
        .filter(|number| can_be(&own, *number, line, place))
        .filter_map(|number| {
            let or_another = others().any(|other| can_be(&own, number, line, other));
            Some((own.get(number)?.0, or_another))
        })
        .collect()
}

/// Whether the device with this number among those that are there can be the nameless one that had this place.
fn can_be(own: &[(usize, &FoundAs)], number: usize, line: &[Identity], place: usize) -> bool {
    let (Some((_, FoundAs::Nameless { identity, .. })), Some(before), Some(behind)) =
        (own.get(number), own.get(..number), own.get(number + 1..))
    else {
        return false;
    };
    let (Some(wanted), Some(front), Some(back)) =
        (line.get(place), line.get(..place), line.get(place + 1..))
    else {
        return false;
    };
    identity == wanted && fit(before, 0, front) && fit(behind, place + 1, back)
}

/// Whether these are devices of this part of a line, which begins with place `from`, in its order; some may be missing.
fn fit(seen: &[(usize, &FoundAs)], from: usize, line: &[Identity]) -> bool {
    let mut places = (from..).zip(line);
    seen.iter()
        .all(|(_, seen)| places.any(|(place, identity)| seen.is(place, identity)))
}

impl FoundAs {
    fn is(&self, place: usize, identity: &Identity) -> bool {
        match self {
            Self::Known(known) => *known == place,
            Self::Nameless { identity: own, .. } => own == identity,
            Self::Optional { .. } => false,
        }
    }
}

fn to_position(at: usize) -> u16 {
    u16::try_from(at).unwrap_or(u16::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(product: u32, serial: u32) -> Identity {
        Identity {
            vendor: 1,
            product,
            revision: 3,
            serial,
        }
    }

    fn nameless(identity: Identity) -> Seen {
        let (station, runs) = (0, false);
        let who = FoundAs::Nameless { identity, runs };
        Seen { station, who }
    }

    fn known(place: usize) -> Seen {
        let who = FoundAs::Known(place);
        let station = KnownLine::station_of(place);
        Seen { station, who }
    }

    const NOBODY: [(usize, bool); 0] = [];

    #[test]
    fn between_two_that_are_known_the_nameless_one_is_the_one_that_is_missing_there() {
        let line = [one(1, 0), one(2, 0), one(2, 0), one(2, 0)];
        let seen = [known(0), known(1), nameless(one(2, 0)), known(3)];
        assert_eq!(candidates(&line, 2, &seen), [(2, false)]);
        assert_eq!(candidates(&line, 1, &seen), NOBODY, "it is known");
        // The first is missing, so that all have moved up.
        assert_eq!(candidates(&line, 2, &seen[1..]), [(1, false)]);
    }

    #[test]
    fn all_without_a_name_are_told_apart_by_their_order_if_all_are_there() {
        let line = [one(2, 0), one(2, 0), one(3, 0), one(2, 0)];
        let seen = line.map(nameless);
        for place in 0..4 {
            assert_eq!(candidates(&line, place, &seen), [(place, false)]);
        }
    }

    #[test]
    fn of_two_that_are_alike_and_one_missing_nobody_knows_which_one_is_there() {
        let line = [one(2, 0), one(2, 0), one(2, 0)];
        let seen = [known(0), nameless(one(2, 0))];
        assert_eq!(candidates(&line, 1, &seen), [(1, true)]);
        assert_eq!(candidates(&line, 2, &seen), [(1, true)]);
        // A serial number shows it.
        let line = [one(2, 0), one(2, 1), one(2, 2)];
        let seen = [known(0), nameless(one(2, 2))];
        assert_eq!(candidates(&line, 1, &seen), NOBODY);
        assert_eq!(candidates(&line, 2, &seen), [(1, false)]);
    }

    #[test]
    fn a_stranger_is_left_out_wherever_it_stands() {
        let line = [one(1, 0), one(2, 7), one(3, 0)];
        let seen = [known(0), nameless(one(9, 9)), nameless(one(2, 7)), known(2)];
        assert_eq!(candidates(&line, 1, &seen), [(2, false)]);
        let other_serial = [known(0), nameless(one(2, 8)), known(2)];
        assert_eq!(candidates(&line, 1, &other_serial), NOBODY);
    }
}
