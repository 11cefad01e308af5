//! Optional groups: devices that come into a running line and leave it.
//!
//! A group is there as a whole or not at all. It joins by the same steps as a device that is brought back (`recovery`), and leaves when one
//! of its devices falls silent. Ports that were opened when the line was whole close by themselves when their link is lost, and are
//! opened here, when there is a link again: what is plugged in halfway costs some cycles at most.

use std::{
    cell::{Cell, RefCell},
    future,
    ops::Range,
    rc::Rc,
    slice,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use super::recovery::Recovery;
use crate::{
    bus::{
        cycle::CycleClock,
        error::{NetworkError, RegisterError},
        event::NetworkEvent,
        expected::{self, DevicePlace, Expected, Present},
        line::{self, KnownLine, NewDevice},
        log::LogRecord,
        watch::at_once,
    },
    coe::DriveId,
    esc,
    sii::Identity,
};

/// How often the line is looked at.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// How long after it the line is looked at again where a group could not join, or a device is nobody's.
const TRY_AGAIN: Duration = Duration::from_secs(2);

/// Whether the devices of an optional group are in the line: made by [`Network::hot_connect`](crate::Network::hot_connect).
///
/// ```no_run
/// # async fn example(net: servocrab::Network) -> Result<(), Box<dyn std::error::Error>> {
/// let drill = net.hot_connect("drill")?;
/// drill.joined().await?; // somebody puts it in
/// net.axis("spindle")?.enable().await?;
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct HotConnect {
    group: Arc<GroupState>,
    clock: CycleClock,
}

impl HotConnect {
    /// The name of the group.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.group.name
    }

    /// Whether it has joined, and has not left since. A device of it that has left OP meanwhile is told by
    /// [`LeftOp`](crate::bus::NetworkEvent::LeftOp), as of any other.
    #[must_use]
    pub fn is_joined(&self) -> bool {
        self.group.is_joined()
    }

    /// Waits until it has joined. Its axes are disabled then, and not referenced.
    ///
    /// # Errors
    /// [`NetworkError::Thread`] once the network has ended.
    pub async fn joined(&self) -> Result<(), NetworkError> {
        self.until(true).await
    }

    /// Waits until it has left.
    ///
    /// # Errors
    /// [`NetworkError::Thread`] once the network has ended.
    pub async fn left(&self) -> Result<(), NetworkError> {
        self.until(false).await
    }

    async fn until(&self, is_joined: bool) -> Result<(), NetworkError> {
        while self.is_joined() != is_joined {
            self.clock.next_cycle().await?;
        }
        Ok(())
    }
}

/// What the program sees of a group.
#[derive(Debug)]
pub(in crate::bus) struct GroupState {
    pub name: String,
    is_joined: AtomicBool,
}

impl GroupState {
    pub fn new(name: String) -> Arc<Self> {
        let is_joined = AtomicBool::new(false);
        Arc::new(Self { name, is_joined })
    }

    pub fn handle(self: &Arc<Self>, clock: CycleClock) -> HotConnect {
        let group = Arc::clone(self);
        HotConnect { group, clock }
    }

    fn is_joined(&self) -> bool {
        self.is_joined.load(Ordering::Acquire)
    }
}

/// A group, on the bus thread.
pub(super) struct Group {
    state: Arc<GroupState>,
    /// Its first drive.
    first: DriveId,
    /// The places of its devices in the exchange.
    places: Range<usize>,
    /// How they are declared.
    declared: Vec<(DevicePlace, Expected)>,
    /// Why it could not join the last time: told once.
    trouble: RefCell<String>,
}

impl Group {
    pub fn new(
        state: Arc<GroupState>,
        first: DriveId,
        places: Range<usize>,
        declared: Vec<(DevicePlace, Expected)>,
    ) -> Self {
        Self {
            state,
            first,
            places,
            declared,
            trouble: RefCell::default(),
        }
    }

    fn is_joined(&self) -> bool {
        self.state.is_joined()
    }
}

/// The groups that a look at the line has found.
struct Arrivals {
    groups: Vec<usize>,
    /// No other new device is there: it may say more later.
    are_all: bool,
}

/// Lets groups join and leave.
pub(super) struct HotConnecting {
    recovery: Rc<Recovery>,
    groups: Vec<Group>,
    /// The AL states of the line OR-ed together and how many they are, when all is well: others with each device that joins or leaves.
    pub usual: Cell<Option<(u8, u16)>>,
    /// Devices that nobody declares, as of the last look, each with whether it was told of.
    strangers: RefCell<Vec<(Present, bool)>>,
}

impl HotConnecting {
    pub const fn new(recovery: Rc<Recovery>, groups: Vec<Group>) -> Self {
        Self {
            recovery,
            groups,
            usual: Cell::new(None),
            strangers: RefCell::new(Vec::new()),
        }
    }

    /// Lets those join that are there at the start.
    pub async fn begin(&self) -> Result<(), NetworkError> {
        if self.groups.is_empty() {
            return Ok(());
        }
        let members = self.groups.iter().flat_map(|group| group.places.clone());
        members.for_each(|place| self.recovery.take_out(place));
        self.set_all_ports(esc::AUTO_CLOSE).await?;
        self.let_join().await;
        Ok(())
    }

    /// For as long as the network lives.
    pub async fn run(&self) {
        if self.groups.is_empty() {
            return future::pending().await;
        }
        smol::future::or(self.connect(), self.watch_ports()).await;
    }

    async fn connect(&self) {
        let time = &self.recovery.context.time;
        // How many there were at the last two looks, and at the last search.
        let (mut before, mut searched) = (None, None);
        let mut again_at = None;
        loop {
            time.sleep(LOOK_EVERY).await;
            for group in self.groups.iter().filter(|group| group.is_joined()) {
                if self.has_lost_one(group) {
                    self.leave(group).await;
                    searched = None;
                }
            }
            let count = self.count();
            let is_steady = count.is_some() && count == before;
            before = count;
            let now = time.now();
            let is_due = count != searched || again_at.is_some_and(|at| now >= at);
            if is_steady && is_due {
                let is_done = self.let_join().await;
                searched = count;
                again_at = (!is_done).then(|| time.now().saturating_add(TRY_AGAIN));
            }
        }
    }

    /// Lets each absent group join whose devices are there. False where that is to be tried again.
    async fn let_join(&self) -> bool {
        let Ok(Some(arrivals)) = self.search().await else {
            return false;
        };
        let mut is_done = arrivals.are_all;
        let groups = arrivals.groups.into_iter();
        for group in groups.filter_map(|at| self.groups.get(at)) {
            match self.join(group).await {
                Ok(()) => {
                    group.trouble.borrow_mut().clear();
                    group.state.is_joined.store(true, Ordering::Release);
                    self.tell(NetworkEvent::Joined {
                        group: group.state.name.clone(),
                        drive: group.first.clone(),
                    });
                }
                Err(error) => {
                    is_done = false;
                    self.take_out(group).await;
                    self.complain(group, &error);
                }
            }
            self.usual.set(None);
        }
        is_done
    }

    /// Looks which absent groups are there, and gives their devices their addresses.
    async fn search(&self) -> Result<Option<Arrivals>, NetworkError> {
        let recovery = &self.recovery;
        let _searching = recovery.search.lock().await;
        let registers = &recovery.context.registers;
        let line = recovery.line.borrow().clone();
        let lasting = line.devices.len();
        let joined = self.groups.iter().filter(|group| group.is_joined());
        let members = joined.flat_map(|group| group.places.clone());
        let members: Vec<_> = members.map(|place| self.number(place)).collect();
        let is_in_use = |number| number < lasting || members.contains(&number);
        let found = line.name_new_ones(registers, is_in_use, |new| self.recognise(new));
        found.await.map_err(NetworkError::Line)
    }

    /// Which of these devices get which addresses, and what is there by that.
    fn recognise(&self, new: &[NewDevice]) -> (Vec<(usize, u16)>, Arrivals) {
        let there: Vec<_> = new.iter().map(|device| device.present.clone()).collect();
        let mut named = Vec::new();
        let mut groups = Vec::new();
        for (number, group) in self.groups.iter().enumerate() {
            if group.is_joined() {
                continue;
            }
            match expected::locate(&group.declared, &there) {
                Ok(None) => {}
                Ok(Some(places)) => {
                    let stations = group.places.clone().map(|place| self.station(place));
                    named.extend(places.into_iter().zip(stations));
                    groups.push(number);
                }
                Err(mismatch) => self.complain(group, &mismatch.into()),
            }
        }
        self.tell_of_strangers(new);
        let are_all = named.len() == new.len();
        (named, Arrivals { groups, are_all })
    }

    /// Tells of those that are nobody's, each once as long as it is there. One that has just been switched on may not say yet who it is.
    fn tell_of_strangers(&self, new: &[NewDevice]) {
        let mut strangers = Vec::new();
        for NewDevice { present, station } in new {
            let absent = self.groups.iter().filter(|group| !group.is_joined());
            let mut declared = absent.flat_map(|group| &group.declared);
            let is_meant = declared.any(|(place, _)| present.says(*place));
            let line = self.recovery.line.borrow();
            let mut lasting = line.devices.iter();
            let Identity {
                vendor, product, ..
            } = present.id.identity;
            // It may be one that is to be recovered, or that is to replace one.
            let may_be_lasting =
                lasting.any(|one| (one.identity.vendor, one.identity.product) == (vendor, product));
            if station.is_some() || is_meant || may_be_lasting {
                continue;
            }
            let before = self.strangers.borrow();
            let mut before = before.iter();
            let before = before.find_map(|(known, told)| (known == present).then_some(*told));
            // One whose EEPROM cannot be read says nothing yet.
            if before == Some(false) && present.id.identity != Identity::default() {
                self.tell(NetworkEvent::Stranger(Arc::new(present.clone())));
            }
            strangers.push((present.clone(), before.is_some()));
        }
        self.strangers.replace(strangers);
    }

    /// Brings the devices of a group into OP, one after the other.
    async fn join(&self, group: &Group) -> Result<(), NetworkError> {
        for place in group.places.clone() {
            self.recovery.join(place).await?;
        }
        for place in group.places.clone() {
            self.recovery.axes.borrow_mut().set_absent(place, false);
        }
        Ok(())
    }

    fn has_lost_one(&self, group: &Group) -> bool {
        let cycle = self.recovery.context.cycle.borrow();
        let drives = cycle.as_ref().map(|cycle| &cycle.exchange.drives);
        drives.is_some_and(|drives| {
            let members = drives.get(group.places.clone());
            members.is_some_and(|members| members.iter().any(|drive| drive.lost && !drive.away))
        })
    }

    async fn leave(&self, group: &Group) {
        group.state.is_joined.store(false, Ordering::Release);
        self.take_out(group).await;
        self.usual.set(None);
        self.tell(NetworkEvent::Left {
            group: group.state.name.clone(),
            drive: group.first.clone(),
        });
    }

    /// From now on it is absent. What is left of it goes to INIT.
    async fn take_out(&self, group: &Group) {
        let registers = &self.recovery.context.registers;
        // All of them before anything is waited for.
        let places = || group.places.clone();
        places().for_each(|place| self.recovery.take_out(place));
        for place in places() {
            // Nobody there need answer.
            let _ = line::set_back(registers, self.station(place)).await;
        }
    }

    /// Where the devices of groups begin in the exchange.
    fn first_place(&self) -> usize {
        self.groups.first().map_or(0, |group| group.places.start)
    }

    fn lasting(&self) -> usize {
        self.recovery.line.borrow().devices.len()
    }

    /// The number of the device at this place of the exchange.
    fn number(&self, place: usize) -> usize {
        let member = place.saturating_sub(self.first_place());
        self.lasting().saturating_add(member)
    }

    fn station(&self, place: usize) -> u16 {
        KnownLine::station_of(self.number(place))
    }

    fn complain(&self, group: &Group, error: &NetworkError) {
        let text = error.to_string();
        if *group.trouble.borrow() == text {
            return;
        }
        self.tell(NetworkEvent::NotJoined {
            group: group.state.name.clone(),
            drive: group.first.clone(),
            why: text.clone(),
        });
        group.trouble.replace(text);
    }

    fn tell(&self, event: NetworkEvent) {
        let context = &self.recovery.context;
        let note = LogRecord::Passed(event.clone());
        context.log.record(context.time.now(), note);
        self.recovery.control.report(event);
    }

    /// Whether the last cycle brought all frames, and no device counts in them that nobody knows.
    fn is_undisturbed(&self) -> bool {
        let cycle = self.recovery.context.cycle.borrow();
        let last = cycle.as_ref().map(|cycle| cycle.last);
        last.is_some_and(|last| last.al_status.is_some() && !last.wrong)
    }

    /// How many devices answered in the last cycle.
    fn count(&self) -> Option<u16> {
        let cycle = self.recovery.context.cycle.borrow();
        let (_, count) = cycle.as_ref()?.last.al_status?;
        Some(count)
    }
}

// The ports at which devices are plugged in and out.

/// How often their links are looked at.
const PORTS_EVERY: Duration = Duration::from_millis(100);
/// In so many looks a link must be there before its port is opened: a connector that is being put in has one now and then.
const STEADY_LOOKS: u32 = 3;
/// After so many looks a port is tried again from which frames did not come back, and at last each time after so many. Other trouble may have
/// kept them back.
const SECOND_TRY: u32 = 50;
const LAST_TRIES: u32 = 3000;
/// Within so many cycles all frames must be back once a port was opened.
const TRIED_FOR: u64 = 3;
/// How long its closing may wait for an answer, which need not come.
const CLOSING: Duration = Duration::from_millis(50);
/// Of DL control 0101h, both bits of a port: closed.
const CLOSED: u8 = 0x03;
/// Of DL status 0110h: port 0 has a link; its loop is closed.
const LINK: u16 = 0x0010;
const LOOP_CLOSED: u16 = 0x0100;

/// A port of a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct DevicePort {
    /// The number of the device.
    device: usize,
    port: u8,
}

impl DevicePort {
    fn station(self) -> u16 {
        KnownLine::station_of(self.device)
    }
}

/// A port whose loop is closed although it has a link.
struct ClosedPort {
    at: DevicePort,
    looks: u32,
    /// It is opened after so many looks: more each time that frames which went out of it did not come back.
    opened_after: u32,
}

impl ClosedPort {
    const fn is_bad(&self) -> bool {
        self.opened_after > STEADY_LOOKS
    }
}

impl HotConnecting {
    /// All ports open and close by themselves again.
    pub async fn give_ports_back(&self) -> Result<(), NetworkError> {
        self.set_all_ports(0).await
    }

    async fn set_all_ports(&self, control: u8) -> Result<(), NetworkError> {
        if self.groups.is_empty() {
            return Ok(());
        }
        let registers = &self.recovery.context.registers;
        let set = registers.broadcast(esc::PORTS, &[control]).await;
        set.map_err(NetworkError::Line)
    }

    async fn watch_ports(&self) {
        let context = &self.recovery.context;
        let mut closed: Vec<ClosedPort> = Vec::new();
        loop {
            context.time.sleep(PORTS_EVERY).await;
            // Of a group that has left as a whole, one may answer still.
            let looks = (0..self.devices()).map(|device| {
                let registers = context.registers.clone();
                let station = KnownLine::station_of(device);
                async move { (device, registers.read(station, esc::DL_STATUS).await) }
            });
            for (device, status) in at_once(context, looks).await {
                let Ok(status) = status.map(u16::from_le_bytes) else {
                    continue;
                };
                for port in 1..4 {
                    let at = DevicePort { device, port };
                    let has_link = status & (LINK << port) != 0;
                    let is_closed = status & (LOOP_CLOSED << (2 * port)) != 0;
                    let known = closed.iter_mut().find(|closed| closed.at == at);
                    match known {
                        Some(known) if has_link && is_closed => known.looks += 1,
                        None if has_link && is_closed => closed.push(ClosedPort {
                            at,
                            looks: 1,
                            opened_after: STEADY_LOOKS,
                        }),
                        _ => closed.retain(|closed| closed.at != at),
                    }
                }
            }
            let bad = closed.iter().filter(|closed| closed.is_bad());
            let bad: Vec<_> = bad.map(|closed| closed.at).collect();
            let is_due = |closed: &&mut ClosedPort| closed.looks >= closed.opened_after;
            if let Some(port) = closed.iter_mut().find(is_due)
                && !self.open(port.at, &bad).await
            {
                if !port.is_bad() {
                    self.tell_of_half_plugged(port.at);
                }
                port.looks = 0;
                let later = port.opened_after.saturating_mul(2);
                port.opened_after = later.clamp(SECOND_TRY, LAST_TRIES);
            }
        }
    }

    /// Opens a port, and closes it again if what is plugged in disturbs the line. Those that are bad stay closed.
    async fn open(&self, port: DevicePort, bad: &[DevicePort]) -> bool {
        let Recovery { context, .. } = &*self.recovery;
        let registers = &context.registers;
        self.let_the_silent_leave().await;
        let bad = bad.iter().filter(|bad| bad.device == port.device);
        let bad = bad.filter(|bad| **bad != port);
        let open = bad.fold(esc::AUTO_CLOSE, |control, bad| {
            control | CLOSED << (2 * bad.port)
        });
        let opening = registers.write(port.station(), esc::PORTS, slice::from_ref(&open));
        let opening = async {
            // The frame that opens it may be the first one that is lost.
            let _ = opening.await;
            future::pending().await
        };
        let cycles = &context.counters.cycles;
        let opened = cycles.get() + 1;
        let tried = async {
            // One of them may be lost otherwise.
            let mut are_back = false;
            while cycles.get() < opened + TRIED_FOR {
                context.time.sleep(self.recovery.period / 2).await;
                are_back |= cycles.get() > opened && self.is_undisturbed();
            }
            are_back
        };
        let is_undisturbed = smol::future::or(opening, tried).await;
        if is_undisturbed && KnownLine::has_namesakes(registers).await != Ok(true) {
            return true;
        }
        let closed = [open | CLOSED << (2 * port.port)];
        let closing = registers.write(port.station(), esc::PORTS, &closed);
        context.time.within(CLOSING, closing).await;
        false
    }

    /// A tool that does not answer may be behind the port that is to be opened. It comes back as one that was out, however long the program
    /// would have waited for it.
    async fn let_the_silent_leave(&self) {
        for group in self.groups.iter().filter(|group| group.is_joined()) {
            let mut is_silent = false;
            for place in group.places.clone() {
                let status = self.recovery.status(self.station(place)).await;
                is_silent |= status == Err(RegisterError::NotAnswered);
            }
            if is_silent {
                self.leave(group).await;
            }
        }
    }

    fn tell_of_half_plugged(&self, DevicePort { device, port }: DevicePort) {
        let first = self.first_place();
        let line = self.recovery.line.borrow();
        let lasting = line.devices.get(device).cloned();
        let device = lasting.or_else(|| {
            let place = device.checked_sub(line.devices.len())? + first;
            let member = self.recovery.devices.get(place)?;
            Some(DriveId::clone(&member.id))
        });
        if let Some(device) = device {
            self.tell(NetworkEvent::HalfPlugged { device, port });
        }
    }

    /// How many devices there are at most.
    fn devices(&self) -> usize {
        let members: usize = self.groups.iter().map(|group| group.places.len()).sum();
        self.lasting() + members
    }
}
