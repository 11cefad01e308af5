//! From the description of a line to a running network.

use smol::channel::{Receiver, Sender, bounded, unbounded};
use std::{sync::Arc, thread, time::Duration};

use crate::{
    bus::{
        device::{
            config::{DriveConfig, Watchdog},
            io::IoConfig,
            progress::{BringUpProgress, Listener, StepDone},
        },
        error::{NetworkError, SettingError},
        expected::{DevicePlace, Expected},
        log::{Log, Subscriber, Writer},
        real_time::RealTime,
        requests::{BusLoop, Reactor, WaitStrategy, wake_on_time},
        watch::{Control, Guard},
    },
    link::{Link, RawSocket},
    wakes::{End, Wakes},
};

use super::{
    Network,
    scan::{self, Line},
    supervisor::{self, Started},
};

/// Describes a network: its link, its cycle, its drives.
///
/// ```no_run
/// # async fn example() -> Result<(), Box<dyn std::error::Error>> {
/// use servocrab::{DriveConfig, Network, drives};
/// use std::time::Duration;
/// let net = Network::builder()
///     .interface("eth0")
///     .cycle(Duration::from_millis(1))
///     .drive(0, DriveConfig::new(drives::akd2g()).axis("x").axis("y"))
///     .start()
///     .await?;
/// let x = net.axis("x")?;
/// # Ok(())
/// # }
/// ```
#[must_use]
pub struct NetworkBuilder {
    link: LinkChoice,
    real_time: RealTime,
    wait_strategy: Option<WaitStrategy>,
    listener: Listener,
    plan: LinePlan,
}

enum LinkChoice {
    None,
    Interface(String),
    Link(Box<dyn Link + Send>),
}

impl LinkChoice {
    fn open(self) -> Result<Box<dyn Link + Send>, NetworkError> {
        match self {
            Self::None => Err(NetworkError::NoLink),
            Self::Interface(name) => Ok(Box::new(RawSocket::open(&name)?)),
            Self::Link(link) => Ok(link),
        }
    }
}

impl Network {
    /// Begins the description of a network: a cycle of 1 ms, armed watchdogs, no drives yet.
    pub const fn builder() -> NetworkBuilder {
        NetworkBuilder {
            link: LinkChoice::None,
            real_time: RealTime::new(),
            wait_strategy: None,
            listener: Listener::NOBODY,
            plan: LinePlan {
                cycle: Duration::from_millis(1),
                drives: Vec::new(),
                ios: Vec::new(),
                others: Vec::new(),
                groups: Vec::new(),
                complete: false,
                watchdog: Watchdog::Armed(None),
            },
        }
    }
}

impl NetworkBuilder {
    /// Uses a raw socket on this network interface (Linux; needs `CAP_NET_RAW`).
    pub fn interface(mut self, name: &str) -> Self {
        self.link = LinkChoice::Interface(name.to_owned());
        self
    }

    /// Uses this link.
    pub fn link(mut self, link: impl Link + Send + 'static) -> Self {
        self.link = LinkChoice::Link(Box::new(link));
        self
    }

    /// The time from one exchange of process data to the next: 50 µs to 1 s. Without it: 1 ms.
    pub const fn cycle(mut self, cycle: Duration) -> Self {
        self.plan.cycle = cycle;
        self
    }

    /// What the bus thread gets of the operating system so that its cycles come on time. Without it: nothing.
    pub fn real_time(mut self, real_time: RealTime) -> Self {
        self.real_time = real_time;
        self
    }

    /// Whether the bus thread sleeps or spins while it waits. Without it: what [`WaitStrategy::suited_to`] says of the cycle and of this
    /// machine.
    pub const fn wait_strategy(mut self, wait_strategy: WaitStrategy) -> Self {
        self.wait_strategy = Some(wait_strategy);
        self
    }

    /// A drive at this position in the line (the first SubDevice is 0), or wherever the one with this alias or identity stands.
    /// SubDevices that are not named stay in PREOP.
    ///
    /// ```
    /// use servocrab::{DriveConfig, Network, bus::DevicePlace, drives};
    /// let builder = Network::builder()
    ///     .drive(1, DriveConfig::new(drives::akd2g()).axis("x"))
    ///     .drive(DevicePlace::Alias(7), DriveConfig::new(drives::akd2g()).axis("z").serial(4711));
    /// ```
    pub fn drive(mut self, place: impl Into<DevicePlace>, drive: DriveConfig) -> Self {
        self.plan.drives.push((place.into(), drive));
        self
    }

    /// A device that is no drive, whose inputs and outputs the program uses: [`Network::io`] gives them by the name that it has in
    /// `io`.
    pub fn io(mut self, place: impl Into<DevicePlace>, io: IoConfig) -> Self {
        self.plan.ios.push((place.into(), io));
        self
    }

    /// Devices that come and go together, such as a tool: they may be absent at the start and later, and join while all others go on. Each is
    /// told by its alias, its identification or its identity, never by its position.
    ///
    /// [`Network::hot_connect`] says whether they are there; [`Joined`](crate::bus::NetworkEvent::Joined),
    /// [`NotJoined`](crate::bus::NetworkEvent::NotJoined) and [`Left`](crate::bus::NetworkEvent::Left) are its events. Handles of their axes
    /// exist from the start on, and fail with [`Failure::Absent`](crate::Failure::Absent) while they are not there. Positions do not count them:
    /// those of all others are the same with and without them.
    ///
    /// ```
    /// use servocrab::{DriveConfig, Network, bus::DevicePlace, drives};
    /// let builder = Network::builder()
    ///     .drive(0, DriveConfig::new(drives::akd2g()).axis("x"))
    ///     .optional("drill", |group| {
    ///         group.drive(DevicePlace::Alias(7), DriveConfig::new(drives::pp2010()).axis("spindle"))
    ///     });
    /// ```
    pub fn optional(
        mut self,
        name: &str,
        declare: impl FnOnce(HotConnectGroup) -> HotConnectGroup,
    ) -> Self {
        let group = declare(HotConnectGroup(GroupPlan {
            name: name.to_owned(),
            drives: Vec::new(),
        }));
        self.plan.groups.push(group.0);
        self
    }

    /// A device that must be in the line and is left alone, in PREOP: a coupler, a terminal, a drive of somebody else's.
    ///
    /// ```
    /// use servocrab::{Network, bus::Expected};
    /// let builder = Network::builder().expect(0, Expected::new(0x2, 0x044C_2C52).named("EK1100"));
    /// ```
    pub fn expect(mut self, place: impl Into<DevicePlace>, device: Expected) -> Self {
        self.plan.others.push((place.into(), device));
        self
    }

    /// The line has no other devices than those that were declared: one more is an error.
    pub const fn complete(mut self) -> Self {
        self.plan.complete = true;
        self
    }

    /// Reports the progress of the bring-up, after each step of each drive, and likewise whenever a device is brought back into OP ([`Network::recover`]). It
    /// is called where that is awaited, and never on the bus thread: neither the bring-up nor the cycles wait for it, but what
    /// is awaited is not ready before it has returned.
    ///
    /// ```
    /// use servocrab::Network;
    /// let builder = Network::builder()
    ///     .on_progress(|at| eprintln!("{}/{}: {}: {}", at.done, at.total, at.drive, at.step));
    /// ```
    pub fn on_progress(
        mut self,
        listener: impl Fn(&BringUpProgress<'_>) + Send + Sync + 'static,
    ) -> Self {
        self.listener = Listener::new(listener);
        self
    }

    /// After this time without process data the drives leave OP and stop their axes. Without it: twenty cycles, at least
    /// 100 ms and at most 6.5 s. It must be longer than a cycle, and from 100 µs to 6.5 s (register 0420h counts 100 µs).
    pub fn watchdog(mut self, time: Duration) -> Self {
        self.plan.watchdog = Watchdog::Armed(Some(time));
        self
    }

    /// Does without the process-data watchdog: the axes go on moving when this program or its computer dies. The reason
    /// goes into the log.
    pub fn without_watchdog(mut self, reason: &str) -> Self {
        self.plan.watchdog = Watchdog::Off(reason.to_owned());
        self
    }

    /// Configures the line, starts the bus thread, and brings the drives into OP. The axes are disabled then.
    ///
    /// A caller that drops the future ends the bring-up: the drives are sent to INIT, and the link is free again when it is dropped,
    /// which takes some milliseconds, and a second where nobody answers. Dropping it waits for that: not on a thread that the `tracing`
    /// subscriber waits for.
    ///
    /// What happens on the bus is logged to the `tracing` subscriber that is current here. As soon as there are cycles a thread of its
    /// own, `servocrab-log`, does that, so that a subscriber that blocks stops none. Its events carry the time of the bus as the
    /// field `at`, and how many found no room while it was behind is an event too. The network's end waits for the last ones, but
    /// not for longer than a second.
    ///
    /// # Errors
    /// Everything that can be wrong with the link, the line or a drive: see [`NetworkError`].
    pub async fn start(self) -> Result<Network, NetworkError> {
        let (mut starting, parts) = self.prepare()?;
        let subscriber = Subscriber::current();
        let thread = thread::Builder::new()
            .name("servocrab-bus".into())
            .spawn(move || subscriber.of(|| parts.run()))
            .map_err(|error| NetworkError::Thread(error.to_string()))?;
        starting.guard.watch(thread);
        starting.network().await
    }

    /// The network and its loop apart, for a program that runs the loop on a thread of its own making (with a real-time
    /// priority, say), or turn by turn in virtual time ([`BusLoop::run_until`], with an example). The loop stays on the thread on which this is called, which gets
    /// what [`real_time`](Self::real_time) says.
    ///
    /// Events are logged as in [`start`](Self::start), by a thread that may run on the processors of the one on which this is called, but
    /// takes no real-time class from it; in virtual time ([`Link::is_virtual`]) by the turns themselves.
    ///
    /// # Errors
    /// What is wrong with the declaration, or with the link; what the system refuses of real time.
    pub fn split(self) -> Result<(Starting, BusLoop), NetworkError> {
        let (starting, parts) = self.prepare()?;
        parts.real_time.apply()?;
        Ok((starting, parts.into_loop()))
    }

    /// Looks at the line without configuring it: every SubDevice is brought through INIT into PREOP, its SII is read, its
    /// mailbox is served. What was declared of drives is left aside. Whatever the line was doing ends.
    ///
    /// # Errors
    /// What is wrong with the link, or with the line as a whole; what is wrong with one SubDevice stands at that one.
    pub async fn scan(self) -> Result<Line, NetworkError> {
        scan::scan(self.link.open()?).await
    }

    fn prepare(self) -> Result<(Starting, Parts), NetworkError> {
        self.plan.check()?;
        let link = self.link.open()?;
        if let Watchdog::Off(reason) = &self.plan.watchdog {
            tracing::warn!(target: crate::log_target::BUS, reason, "the process-data watchdogs are off");
        }
        let (log, writer) = if link.is_virtual() {
            (Log::default(), None)
        } else {
            let (log, writer) = Writer::start()?;
            (log, Some(writer))
        };
        let (wakes, wakes_end) = if link.is_virtual() {
            Wakes::in_turn()
        } else {
            let started = Wakes::start(self.real_time.priority());
            started.map_err(|error| NetworkError::Thread(error.to_string()))?
        };
        let devices = self.plan.drives.len() + self.plan.ios.len();
        let control = Control::new(devices, wakes);
        control.set_waker(link.waker());
        let (started, starting) = bounded(1);
        let (to_tell, steps) = unbounded();
        let (alive, over) = bounded(1);
        let parts = Parts {
            link,
            real_time: self.real_time,
            wait_strategy: self.wait_strategy,
            plan: self.plan,
            log,
            writer,
            control: Arc::clone(&control),
            started,
            to_tell,
            alive,
            wakes_end,
        };
        let starting = Starting {
            guard: Guard::new(control),
            started: starting,
            steps,
            listener: self.listener,
            over,
        };
        Ok((starting, parts))
    }
}

/// What the bus loop is made of, before it is on its thread.
struct Parts {
    link: Box<dyn Link + Send>,
    real_time: RealTime,
    wait_strategy: Option<WaitStrategy>,
    plan: LinePlan,
    log: Log,
    writer: Option<Writer>,
    control: Arc<Control>,
    started: Sender<Result<Started, NetworkError>>,
    to_tell: Sender<StepDone>,
    alive: Sender<()>,
    /// Last: see [`BusLoop`].
    wakes_end: End,
}

impl Parts {
    /// On the bus thread.
    fn run(self) {
        match self.real_time.apply() {
            Ok(()) => self.into_loop().run(),
            // Nobody takes it when the program has given up meanwhile.
            Err(error) => drop(self.started.try_send(Err(error.into()))),
        }
    }

    fn into_loop(self) -> BusLoop {
        wake_on_time();
        let wait_strategy = self
            .wait_strategy
            .unwrap_or_else(|| WaitStrategy::suited_here(self.plan.cycle));
        let reactor = Reactor::new(
            self.link,
            wait_strategy,
            &self.control.counters,
            &self.control.wakes,
            self.log,
        );
        let context = reactor.context().clone();
        let (started, to_tell) = (self.started, self.to_tell);
        let life =
            supervisor::supervise(context.clone(), self.plan, self.control, started, to_tell);
        if let Some(task) = context.spawn(life) {
            task.detach();
        }
        BusLoop::new(reactor, self.writer, self.alive, self.wakes_end)
    }
}

/// A network on its way to OP, while somebody turns its loop.
pub struct Starting {
    guard: Guard,
    started: Receiver<Result<Started, NetworkError>>,
    steps: Receiver<StepDone>,
    listener: Listener,
    over: Receiver<()>,
}

impl Starting {
    /// The network, once its drives are in OP.
    ///
    /// # Errors
    /// As [`NetworkBuilder::start`].
    pub async fn network(self) -> Result<Network, NetworkError> {
        let waiters = self.guard.waiters();
        let started = self.listener.report_until(self.steps, self.started.recv());
        let ended = || NetworkError::Thread("it ended before the drives were in OP".into());
        let started = waiters
            .relay(started)
            .await
            .unwrap_or_else(|_| Err(ended()));
        let started = match started {
            Ok(started) => started,
            Err(error) => {
                self.guard.gone(&self.over).await;
                return Err(error);
            }
        };
        let (Some(control), thread) = self.guard.release() else {
            return Err(NetworkError::Thread("it was given up".into()));
        };
        let (listener, over) = (self.listener, self.over);
        Ok(Network::new(started, control, listener, over, thread))
    }
}

// What a program wants of its line, and which device of the line each declared one is.

/// The longest time after which a silent drive must count as lost: until then, nothing that waits for it resolves.
const LONGEST_LOSS: Duration = Duration::from_secs(60);

/// What the settings of times may be.
const CYCLES: [Duration; 2] = [Duration::from_micros(50), Duration::from_secs(1)];
const WATCHDOGS: [Duration; 2] = [Duration::from_micros(100), Duration::from_millis(6500)];
const DEADLINES: [Duration; 2] = [Duration::from_millis(1), Duration::from_secs(3600)];
const SETTLING: [Duration; 2] = [Duration::ZERO, Duration::from_secs(60)];
/// With none, every word would count as seen before the drive has it; with a huge one, none ever.
const DRIVE_CYCLES: [Duration; 2] = [Duration::from_micros(1), Duration::from_secs(1)];
/// After which a program that does not feed its liveness counts as hanging.
pub(super) const LIVENESS: [Duration; 2] = [Duration::from_millis(1), Duration::from_secs(3600)];

/// That a time which was set is neither too short nor too long.
pub(super) fn within(
    of: &str,
    setting: &'static str,
    got: Duration,
    [least, most]: [Duration; 2],
) -> Result<(), SettingError> {
    if (least..=most).contains(&got) {
        return Ok(());
    }
    Err(SettingError {
        of: of.to_owned(),
        setting,
        got,
        least,
        most,
    })
}

/// What the program wants of the line.
#[derive(Debug, Clone)]
pub(in crate::bus) struct LinePlan {
    pub cycle: Duration,
    pub drives: Vec<(DevicePlace, DriveConfig)>,
    pub ios: Vec<(DevicePlace, IoConfig)>,
    /// Devices that must be there and are left alone.
    pub others: Vec<(DevicePlace, Expected)>,
    /// Devices that may come and go.
    pub groups: Vec<GroupPlan>,
    /// No other devices may be there.
    pub complete: bool,
    pub watchdog: Watchdog,
}

impl LinePlan {
    /// What is wrong with the declaration itself.
    pub fn check(&self) -> Result<(), NetworkError> {
        let wrong = |text: String| Err(NetworkError::Declaration(text));
        if self.drives.is_empty() && self.ios.is_empty() {
            return wrong("no drive was declared".into());
        }
        for (number, group) in self.groups.iter().enumerate() {
            if let Some(mistake) = group.mistake() {
                return wrong(format!("optional group `{}`: {mistake}", group.name));
            }
            let mut before = self.groups.iter().take(number);
            if before.any(|other| other.name == group.name) {
                return wrong(format!("two optional groups are named `{}`", group.name));
            }
        }
        within("the network", "cycle", self.cycle, CYCLES)?;
        if let Watchdog::Armed(Some(time)) = self.watchdog {
            // One that is not longer than a cycle expires between two of them.
            let [least, most] = WATCHDOGS;
            let least = least.max(self.cycle.saturating_add(least));
            within("the network", "watchdog", time, [least, most])?;
        }
        let mut declared = self.declared();
        let lasting = declared.len();
        declared.extend(self.optional());
        for (number, (place, _)) in declared.iter().enumerate() {
            if place.is_nobodys() {
                return wrong(format!("{place} is that of devices without one"));
            }
            let mut before = declared.iter().take(number);
            if before.any(|(other, _)| other == place) {
                return wrong(format!("two devices are declared at {place}"));
            }
            // By its identity one that comes and goes would be taken for another one of its kind.
            let DevicePlace::Identity {
                vendor,
                product,
                serial: None,
            } = *place
            else {
                continue;
            };
            let mut others = declared.iter().enumerate();
            let is_alike = |other: &Expected| {
                let may_be = |own: Option<u32>, number| own.is_none_or(|own| own == number);
                may_be(other.vendor, vendor) && may_be(other.product, product)
            };
            if others.any(|(other, (_, expected))| {
                other != number && number.max(other) >= lasting && is_alike(expected)
            }) {
                return wrong(format!(
                    "another device of the kind of {place} is declared: declare the one that comes and goes by its alias, its \
                     identification, or its serial number"
                ));
            }
        }
        for (number, (place, io)) in self.ios.iter().enumerate() {
            if let Some(mistake) = io.mistake() {
                return wrong(format!("io at {place}: {mistake}"));
            }
            let mut before = self.ios.iter().take(number);
            if before.any(|(_, other)| other.name == io.name) {
                return wrong(format!("two devices are named `{}`", io.name));
            }
        }
        let mut names = Vec::new();
        let of_groups = self.groups.iter().flat_map(|group| &group.drives);
        for (place, drive) in self.drives.iter().chain(of_groups) {
            if let Some(mistake) = drive.mistake() {
                return wrong(format!("drive at {place}: {mistake}"));
            }
            let drive_cycle = drive.description.traits.drive_cycle;
            let of = format!("drive at {place}");
            within(&of, "drive cycle of its traits", drive_cycle, DRIVE_CYCLES)?;
            if let Some(mistake) = drive.clock.and_then(|clock| clock.mistake(self.cycle)) {
                return wrong(format!("drive at {place}: {mistake}"));
            }
            for axis in &drive.axes {
                if names.contains(&&axis.name) {
                    return wrong(format!("two axes are named `{}`", axis.name));
                }
                names.push(&axis.name);
                let of = format!("axis `{}`", axis.name);
                for (setting, time) in axis.deadlines.each() {
                    within(&of, setting, time, DEADLINES)?;
                }
                if let Some(tolerances) = axis.tolerances {
                    within(&of, "settle time", tolerances.settle, SETTLING)?;
                }
                if let Some(loss) = axis.loss {
                    let longest = self
                        .cycle
                        .saturating_mul(loss.stale_cycles.max(loss.undelivered_cycles));
                    if loss.stale_cycles == 0
                        || loss.undelivered_cycles < loss.stale_cycles
                        || longest > LONGEST_LOSS
                    {
                        return wrong(format!(
                            "axis `{}`: {loss:?} at cycles of {:?} is not at least one stale cycle, at most as many as \
                             undelivered ones, and at most {LONGEST_LOSS:?}: nobody may wait longer for a silent drive",
                            axis.name, self.cycle
                        ));
                    }
                }
            }
        }
        Ok(())
    }

    /// All devices that may come and go, in the order of their groups.
    pub fn optional(&self) -> impl Iterator<Item = (DevicePlace, Expected)> {
        self.groups.iter().flat_map(GroupPlan::declared)
    }

    /// All devices that must be there: the drives first, then those with inputs and outputs.
    pub(super) fn declared(&self) -> Vec<(DevicePlace, Expected)> {
        let drives = self.drives.iter();
        let drives = drives.map(|(place, drive)| (*place, drive.expected()));
        let ios = self.ios.iter();
        let ios = ios.map(|(place, io)| (*place, io.expected.clone()));
        drives
            .chain(ios)
            .chain(self.others.iter().cloned())
            .collect()
    }
}

/// Devices that come and go together, as [`NetworkBuilder::optional`] declares them.
#[derive(Debug, Clone)]
#[must_use]
pub struct HotConnectGroup(GroupPlan);

impl HotConnectGroup {
    /// A drive, wherever the one with this alias, identification or identity stands. How many bytes it exchanges is known from its description
    /// alone. It follows no distributed clock.
    pub fn drive(mut self, place: impl Into<DevicePlace>, drive: DriveConfig) -> Self {
        self.0.drives.push((place.into(), drive));
        self
    }
}

/// What the program wants of an optional group.
#[derive(Debug, Clone)]
pub(in crate::bus) struct GroupPlan {
    pub name: String,
    pub drives: Vec<(DevicePlace, DriveConfig)>,
}

impl GroupPlan {
    fn declared(&self) -> impl Iterator<Item = (DevicePlace, Expected)> {
        let drives = self.drives.iter();
        drives.map(|(place, drive)| (*place, drive.expected()))
    }

    fn mistake(&self) -> Option<String> {
        if self.drives.is_empty() {
            return Some("it has no drive".into());
        }
        self.drives.iter().find_map(|(place, drive)| {
            if matches!(place, DevicePlace::Position(_)) {
                return Some(format!(
                    "at {place} another device stands while this one is not there: declare it by its alias, its identification or its \
                     identity"
                ));
            }
            drive.clock.is_some().then(|| {
                format!("the drive at {place} cannot follow the distributed clock of a line that it comes into")
            })
        })
    }
}
