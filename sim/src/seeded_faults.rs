//! Faults by name and seed: what goes wrong with frames, devices, mailboxes, plants and clocks, as one composable setting.

use core::fmt;
use core::str::FromStr;
use core::time::Duration;
use std::collections::{BTreeMap, VecDeque};

use crate::al::AlState;
use crate::ds402::Plant;
use crate::frame::{DATAGRAM_HEADER, WORKING_COUNTER, datagrams, read_u16};
use crate::segment::Segment;

/// AL status code of a device that falls: a fault of its own.
const OWN_FAULT: u16 = 0x0001;
/// FPRD (ETG.1000.4).
const READ: u8 = 4;
/// First address of an ESC's process memory, where mailboxes are.
const MEMORY: u16 = 0x1000;
/// Mailbox header, CoE header and the first eight bytes of an SDO message (ETG.1000.6).
const SHORTEST_MESSAGE: usize = 16;
/// Mailbox type of CoE, in the low four bits of byte 5; its counter is in the bits above.
const COE: u8 = 3;
/// CoE service of an SDO response, in the high four bits of byte 7.
const SDO_RESPONSE: u8 = 3;
/// Answers that are kept to be given once more.
const KEPT: usize = 64;
/// Error code of a drive's fault: a sensor (DSP 402, 7300h).
const SENSOR_FAULT: u16 = 0x7300;

/// How often something happens, in millionths.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rate(u32);

impl Rate {
    /// So many of a million; more than that is all.
    #[must_use]
    pub fn per_million(millionths: u32) -> Self {
        Self(millionths.min(1_000_000))
    }
}

/// How often something takes longer, and for how long at most.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Delayed {
    /// How often.
    pub rate: Rate,
    /// Longest delay.
    pub most: Duration,
}

/// Something that happens to one SubDevice at a time, once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outage {
    /// Since the first frame, or the first [`FaultyLine::advance`].
    pub at: Duration,
    /// How long it lasts; `None` for good.
    pub lasts: Option<Duration>,
    /// Position of the SubDevice in the line, from zero.
    pub position: usize,
}

/// Which plants the axes get.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PlantChoice {
    /// Those that they have.
    #[default]
    Own,
    /// [`Plant::ideal`].
    Ideal,
    /// [`Plant::seeded`], each axis another one.
    Seeded,
}

/// What goes wrong on a line. Each field is one fault; they add up, and all of them come from one seed: the same frames at
/// the same times meet the same faults.
///
/// As text, separated by commas, [`Faults::from_str`] takes:
///
/// | text | fault |
/// |---|---|
/// | `loss=1%` | of so many frames the request is lost: no SubDevice sees it |
/// | `reply-loss=0.5%` | of so many the reply is lost: every SubDevice has seen it |
/// | `delay=200us` | each frame comes back up to this much later, so that later ones overtake it |
/// | `late=1%/400ms` | so many come back up to this much later, when their request may be given up long since |
/// | `hold=0.1%/12ms` | so many stay in the interface up to this long, and all frames behind them |
/// | `refuse=0.1%` | so many are refused by the interface: [`FaultyLine::send`] says so |
/// | `double=1%` | so many come back twice |
/// | `pass-twice=1%` | so many pass all SubDevices twice |
/// | `foreign=1%` | with so many comes a frame that answers nothing: of another protocol or master, a request, or noise |
/// | `cut-short=1%` | so many come back with their end missing |
/// | `flip=0.1%` | so many come back with one bit inverted |
/// | `flip-header=0.1%` | the same, of a header of the frame or of a datagram |
/// | `flip-data=0.1%` | the same, of the data of a datagram: nobody can tell it from what a SubDevice says |
/// | `miscount=1%` | so many come back with the working counter of a datagram one short |
/// | `counter=1%` | so many come back with any number as the working counter of a datagram |
/// | `cut=2s@1`, `cut=2s+500ms@1` | the cable in front of SubDevice 1 is pulled after 2 s, for good or for 500 ms |
/// | `power=2s+1s@0` | SubDevice 0 is without power for 1 s |
/// | `freeze=2s+50ms@0` | its processor stands still, while its ESC answers |
/// | `fall=3s@0` | it falls to SAFEOP with an error |
/// | `fault=3s@0` | each of its axes has a fault |
/// | `mail-delay=5ms` | each message is answered this much later |
/// | `mail-bits=1%` | of so many answers by CoE the toggle bit, or the counter, is another |
/// | `mail-other=1%` | in place of so many comes an earlier one, about another object |
/// | `mail-emergency=1%` | in place of so many comes an emergency |
/// | `mail-garbage=1%` | in so many some bytes are anything |
/// | `emergencies=1s` | every device with a mailbox sends an emergency once in this time |
/// | `plant=seeded`, `plant=ideal` | the axes get other plants |
/// | `drift=50ppm` | each crystal is too fast or too slow by up to this much |
///
/// Names of rates and times stand once at most; `cut`, `power`, `freeze`, `fall` and `fault` as often as one likes.
///
/// ```
/// use core::time::Duration;
/// use servocrab_sim::{Faults, FaultyLine, Segment, personality};
///
/// let faults: Faults = "loss=30%,delay=200us,cut=20ms@0".parse()?;
/// let segment = Segment::new().with(personality::akd2g());
/// let mut line = FaultyLine::new(segment, &faults.seed(7))?;
/// // One BRD of the AL status, each millisecond.
/// let mut frame = vec![0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x10, 0, 0, 0, 0, 1, 0x88, 0xA4, 14, 0x10];
/// frame.extend([7, 0, 0, 0, 0x30, 0x01, 2, 0, 0, 0, 0, 0, 0, 0]);
/// let mut returned = Vec::new();
/// for millisecond in 0..40 {
///     let now = Duration::from_millis(millisecond);
///     line.send(&frame, now);
///     returned.extend(line.receive(now + Duration::from_micros(200)).map(|_| millisecond));
/// }
/// assert!(returned.len() < 20 && returned.len() > 8, "some were lost: {returned:?}");
/// assert!(returned.iter().all(|millisecond| *millisecond < 20), "then the cable was pulled");
/// # Ok::<(), servocrab_sim::FaultsError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// Seed of everything random in them.
    pub seed: u64,
    /// Requests that are lost.
    pub loss: Rate,
    /// Replies that are lost.
    pub reply_loss: Rate,
    /// Longest delay of a frame.
    pub delay: Duration,
    /// Frames that come back much later.
    pub late: Delayed,
    /// Frames that stay in the interface, with all behind them.
    pub hold: Delayed,
    /// Frames that the interface refuses.
    pub refuse: Rate,
    /// Frames that come back twice.
    pub double: Rate,
    /// Frames that pass all SubDevices twice.
    pub pass_twice: Rate,
    /// Frames with which one comes that answers nothing.
    pub foreign: Rate,
    /// Frames that come back cut short.
    pub cut_short: Rate,
    /// Frames that come back with one bit inverted.
    pub flip: Rate,
    /// Frames that come back with one bit of a header inverted.
    pub flip_header: Rate,
    /// Frames that come back with one bit of the data inverted.
    pub flip_data: Rate,
    /// Frames that come back with a working counter that is one short.
    pub miscount: Rate,
    /// Frames that come back with any working counter.
    pub counter: Rate,
    /// Cables that are pulled.
    pub cut: Vec<Outage>,
    /// SubDevices without power.
    pub power: Vec<Outage>,
    /// SubDevices whose processor stands still.
    pub freeze: Vec<Outage>,
    /// SubDevices that fall to SAFEOP; they do not come back by themselves.
    pub fall: Vec<Outage>,
    /// Drives whose axes have a fault.
    pub fault: Vec<Outage>,
    /// How much later each message is answered.
    pub mail_delay: Duration,
    /// Answers by CoE with another toggle bit or counter.
    pub mail_bits: Rate,
    /// Answers by CoE in whose place an earlier one comes.
    pub mail_other: Rate,
    /// Answers by CoE in whose place an emergency comes.
    pub mail_emergency: Rate,
    /// Answers by CoE with bytes that are anything.
    pub mail_garbage: Rate,
    /// From one emergency to the next, of each device; 0: none.
    pub emergencies: Duration,
    /// The plants of the axes.
    pub plant: PlantChoice,
    /// Parts per million by which crystals are off at most.
    pub drift_ppm: u32,
}

impl Faults {
    /// The same faults from another seed.
    #[must_use]
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// The outages by what they are.
    fn outages(&self) -> impl Iterator<Item = (What, Outage)> + '_ {
        let of = |what, list: &'_ Vec<Outage>| {
            let list = list.clone();
            list.into_iter().map(move |outage| (what, outage))
        };
        of(What::Cut, &self.cut)
            .chain(of(What::Power, &self.power))
            .chain(of(What::Freeze, &self.freeze))
            .chain(of(What::Fall, &self.fall))
            .chain(of(What::Fault, &self.fault))
    }
}

/// The names that [`Faults::from_str`] knows.
const KNOWN: &str = "loss, reply-loss, delay, late, hold, refuse, double, pass-twice, foreign, cut-short, flip, \
                     flip-header, flip-data, miscount, counter, cut, power, freeze, fall, fault, mail-delay, mail-bits, \
                     mail-other, mail-emergency, mail-garbage, emergencies, plant, drift";

/// Why a text gives no [`Faults`], or these do not fit a line.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FaultsError {
    /// There is no fault of this name.
    #[error("there is no fault {name:?}; known are {KNOWN}")]
    Unknown {
        /// The name.
        name: String,
    },
    /// A part of the text has no `=`.
    #[error("{part:?} has no value: a fault is written as loss=1%; known are {KNOWN}")]
    NoValue {
        /// The part.
        part: String,
    },
    /// The value is not of the kind that the fault takes.
    #[error("{name}={value}: {expected}")]
    Value {
        /// Name of the fault.
        name: String,
        /// The value.
        value: String,
        /// What it takes.
        expected: &'static str,
    },
    /// A fault that can be there once stands twice.
    #[error("{name} stands twice")]
    Twice {
        /// Name of the fault.
        name: String,
    },
    /// There is no SubDevice at this position.
    #[error("there is no SubDevice {position}: the line has {devices}, counted from 0")]
    NoDevice {
        /// The position.
        position: usize,
        /// Number of SubDevices.
        devices: usize,
    },
}

const RATE: &str = "expected a share of the frames, such as 1% or 0.05%";
const DELAYED: &str = "expected a share of the frames and a time, such as 1%/400ms";
const TIME: &str = "expected a time, such as 200us, 5ms or 2s";
const OUTAGE: &str =
    "expected a time and a position, such as 2s@1, or 2s+500ms@1 for one that ends";
const PLANT: &str = "expected own, seeded or ideal";
const DRIFT: &str = "expected parts per million up to 1000, such as 50ppm";

impl FromStr for Faults {
    type Err = FaultsError;

    fn from_str(text: &str) -> Result<Self, FaultsError> {
        let mut faults = Self::default();
        let mut seen = Vec::new();
        for part in text
            .split(',')
            .map(str::trim)
            .filter(|part| !part.is_empty())
        {
            let Some((name, value)) = part.split_once('=') else {
                return Err(FaultsError::NoValue {
                    part: part.to_owned(),
                });
            };
            let (name, value) = (name.trim(), value.trim());
            let wrong = |expected| FaultsError::Value {
                name: name.to_owned(),
                value: value.to_owned(),
                expected,
            };
            let rate = || rate(value).ok_or_else(|| wrong(RATE));
            let time = || time(value).ok_or_else(|| wrong(TIME));
            let delayed = || delayed(value).ok_or_else(|| wrong(DELAYED));
            let outage = || outage(value).ok_or_else(|| wrong(OUTAGE));
            match name {
                "cut" => faults.cut.push(outage()?),
                "power" => faults.power.push(outage()?),
                "freeze" => faults.freeze.push(outage()?),
                "fall" => faults.fall.push(outage()?),
                "fault" => faults.fault.push(outage()?),
                _ if seen.contains(&name) => {
                    return Err(FaultsError::Twice {
                        name: name.to_owned(),
                    });
                }
                "loss" => faults.loss = rate()?,
                "reply-loss" => faults.reply_loss = rate()?,
                "late" => faults.late = delayed()?,
                "hold" => faults.hold = delayed()?,
                "refuse" => faults.refuse = rate()?,
                "double" => faults.double = rate()?,
                "pass-twice" => faults.pass_twice = rate()?,
                "foreign" => faults.foreign = rate()?,
                "cut-short" => faults.cut_short = rate()?,
                "flip" => faults.flip = rate()?,
                "flip-header" => faults.flip_header = rate()?,
                "flip-data" => faults.flip_data = rate()?,
                "miscount" => faults.miscount = rate()?,
                "counter" => faults.counter = rate()?,
                "mail-bits" => faults.mail_bits = rate()?,
                "mail-other" => faults.mail_other = rate()?,
                "mail-emergency" => faults.mail_emergency = rate()?,
                "mail-garbage" => faults.mail_garbage = rate()?,
                "delay" => faults.delay = time()?,
                "mail-delay" => faults.mail_delay = time()?,
                "emergencies" => faults.emergencies = time()?,
                "plant" => {
                    faults.plant = match value {
                        "own" => PlantChoice::Own,
                        "seeded" => PlantChoice::Seeded,
                        "ideal" => PlantChoice::Ideal,
                        _ => return Err(wrong(PLANT)),
                    }
                }
                "drift" => {
                    let ppm = value.strip_suffix("ppm").and_then(|ppm| ppm.parse().ok());
                    let ppm = ppm.filter(|ppm| *ppm <= 1_000);
                    faults.drift_ppm = ppm.ok_or_else(|| wrong(DRIFT))?;
                }
                _ => {
                    return Err(FaultsError::Unknown {
                        name: name.to_owned(),
                    });
                }
            }
            seen.push(name);
        }
        Ok(faults)
    }
}

/// A share in per cent.
fn rate(text: &str) -> Option<Rate> {
    let percent: f64 = text.strip_suffix('%')?.trim().parse().ok()?;
    let inside = (0.0..=100.0).contains(&percent);
    inside.then(|| Rate((percent * 10_000.0).round() as u32))
}

/// `1%/400ms`.
fn delayed(text: &str) -> Option<Delayed> {
    let (share, most) = text.split_once('/')?;
    Some(Delayed {
        rate: rate(share.trim())?,
        most: time(most.trim())?,
    })
}

/// A number with its unit.
fn time(text: &str) -> Option<Duration> {
    let digits = text.find(|c: char| c.is_ascii_alphabetic())?;
    let (number, unit) = text.split_at_checked(digits)?;
    let seconds = match unit {
        "ns" => 1e-9,
        "us" => 1e-6,
        "ms" => 1e-3,
        "s" => 1.0,
        _ => return None,
    };
    let number: f64 = number.trim().parse().ok()?;
    Duration::try_from_secs_f64(number * seconds).ok()
}

/// `2s@1` or `2s+500ms@1`.
fn outage(text: &str) -> Option<Outage> {
    let (when, position) = text.split_once('@')?;
    let (at, lasts) = match when.split_once('+') {
        Some((at, lasts)) => (at, Some(time(lasts)?)),
        None => (when, None),
    };
    Some(Outage {
        at: time(at)?,
        lasts,
        position: position.trim().parse().ok()?,
    })
}

/// What an outage is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum What {
    Cut,
    Power,
    Freeze,
    Fall,
    Fault,
    /// The end of one.
    Plug,
    PowerBack,
    Thaw,
    /// Every device with a mailbox sends one.
    Emergencies,
}

/// Is shown each frame that the SubDevices have seen: as it was sent, and as they have left it.
type Witness = Box<dyn FnMut(&[u8], &[u8]) + Send>;

/// A segment behind a wire, both with [`Faults`], in the time of its caller.
pub struct FaultyLine {
    segment: Segment,
    faults: Faults,
    random: u64,
    /// What is to come: when since the begin, what, and to whom. The next is the last.
    to_come: Vec<(Duration, What, usize)>,
    begin: Option<Duration>,
    /// Frames on their way out: when they reach the first SubDevice, in this order.
    outgoing: VecDeque<(Duration, Vec<u8>)>,
    /// Frames on their way back, in the order of their arrival.
    returning: Vec<(Duration, Vec<u8>)>,
    /// Nothing happens to frames.
    quiet: bool,
    witness: Option<Witness>,
    /// What each station has last said of objects by SDO.
    said: VecDeque<(u16, Vec<u8>)>,
    seen: BTreeMap<&'static str, u64>,
}

impl fmt::Debug for FaultyLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("FaultyLine")
            .field("segment", &self.segment)
            .field("faults", &self.faults)
            .field("seen", &self.seen)
            .finish_non_exhaustive()
    }
}

impl FaultyLine {
    /// A line with faults. Plants, crystals and mailboxes of the devices are set at once.
    ///
    /// # Errors
    ///
    /// [`FaultsError::NoDevice`] when an outage is of a SubDevice that the segment does not have.
    pub fn new(mut segment: Segment, faults: &Faults) -> Result<Self, FaultsError> {
        let devices = segment.len();
        let mut to_come = Vec::new();
        for (what, outage) in faults.outages() {
            let position = outage.position;
            if position >= devices {
                return Err(FaultsError::NoDevice { position, devices });
            }
            to_come.push((outage.at, what, position));
            let end = match what {
                What::Cut => What::Plug,
                What::Power => What::PowerBack,
                What::Freeze => What::Thaw,
                _ => continue,
            };
            to_come.extend(
                outage
                    .lasts
                    .map(|lasts| (outage.at.saturating_add(lasts), end, position)),
            );
        }
        if !faults.emergencies.is_zero() {
            to_come.push((faults.emergencies, What::Emergencies, 0));
        }
        // Of two at once the one that stands first comes first.
        to_come.sort_by_key(|(at, ..)| *at);
        to_come.reverse();
        let mut line = Self {
            segment: Segment::new(),
            faults: faults.clone(),
            random: faults.seed ^ 0x4641_554C_5453,
            to_come,
            begin: None,
            outgoing: VecDeque::new(),
            returning: Vec::new(),
            quiet: false,
            witness: None,
            said: VecDeque::new(),
            seen: BTreeMap::new(),
        };
        match faults.plant {
            PlantChoice::Own => {}
            PlantChoice::Ideal => segment.set_plant(Plant::ideal()),
            PlantChoice::Seeded => {
                for position in 0..devices {
                    let axes = segment
                        .device(position)
                        .map_or(0, |device| device.axes().len());
                    for axis in 0..axes {
                        let plant = Plant::seeded(line.next());
                        if let Some(axis) = segment.axis_mut(position, axis) {
                            axis.set_plant(plant);
                        }
                    }
                }
            }
        }
        for position in 0..devices {
            let off = line.between(2_000 * u64::from(faults.drift_ppm));
            let Some(device) = segment.device_mut(position) else {
                continue;
            };
            if faults.drift_ppm > 0 {
                device.set_drift(off as f64 / 1_000.0 - f64::from(faults.drift_ppm));
            }
            if !faults.mail_delay.is_zero() {
                device.set_mailbox_delay(faults.mail_delay);
            }
        }
        line.segment = segment;
        Ok(line)
    }

    /// The segment at the end of the wire.
    #[must_use]
    pub fn segment(&self) -> &Segment {
        &self.segment
    }

    /// The segment at the end of the wire, to be changed.
    pub fn segment_mut(&mut self) -> &mut Segment {
        &mut self.segment
    }

    /// While it is quiet nothing happens to frames and to the messages in them. Outages go on.
    pub const fn set_quiet(&mut self, quiet: bool) {
        self.quiet = quiet;
    }

    /// Shows `witness` each frame that the SubDevices have seen, before anything happens to it on its way back: as it was sent, and as
    /// they have left it.
    pub fn watch(&mut self, witness: impl FnMut(&[u8], &[u8]) + Send + 'static) {
        self.witness = Some(Box::new(witness));
    }

    /// Whoever listened has gone: nothing comes back of what is on its way.
    pub fn forget(&mut self) {
        self.outgoing.clear();
        self.returning.clear();
    }

    /// How often each fault has happened, by its name.
    #[must_use]
    pub fn seen(&self) -> &BTreeMap<&'static str, u64> {
        &self.seen
    }

    /// Nothing goes wrong any more: cables are plugged, devices have power and run. Frames on their way keep their fate.
    pub fn heal(&mut self, now: Duration) {
        self.advance(now);
        let ends = core::mem::take(&mut self.to_come);
        for (_, what, position) in ends.into_iter().rev() {
            if matches!(what, What::Plug | What::PowerBack | What::Thaw) {
                self.happen(what, position, now);
            }
        }
        let plant = self.faults.plant;
        self.faults = Faults {
            plant,
            seed: self.faults.seed,
            ..Faults::default()
        };
        self.segment.plug();
        for position in 0..self.segment.len() {
            if let Some(device) = self.segment.device_mut(position) {
                device.power_on(now);
                device.freeze(false);
                device.set_mailbox_delay(Duration::ZERO);
            }
        }
    }

    /// Runs everything up to `now`, which never goes back from call to call.
    pub fn advance(&mut self, now: Duration) {
        let begin = *self.begin.get_or_insert(now);
        loop {
            let happens = self
                .to_come
                .last()
                .map(|(at, ..)| begin.saturating_add(*at));
            let happens = happens.filter(|at| *at <= now);
            let passes = self.outgoing.front().map(|(at, _)| *at);
            let passes = passes.filter(|at| *at <= now);
            if let Some(at) = happens
                && passes.is_none_or(|passes| at <= passes)
                && let Some((_, what, position)) = self.to_come.pop()
            {
                self.segment.advance(at);
                self.happen(what, position, at);
            } else if passes.is_some()
                && let Some((at, frame)) = self.outgoing.pop_front()
            {
                self.pass(frame, at);
            } else {
                break;
            }
        }
        self.segment.advance(now);
    }

    /// Sends a frame into the wire. `false` when the interface refuses it.
    pub fn send(&mut self, frame: &[u8], now: Duration) -> bool {
        self.advance(now);
        if self.hits(self.faults.refuse, "refuse") {
            return false;
        }
        if self.hits(self.faults.loss, "loss") {
            return true;
        }
        let behind = self.outgoing.back().map_or(now, |(at, _)| now.max(*at));
        let at = behind.saturating_add(self.delayed(self.faults.hold, "hold"));
        if at > now {
            self.outgoing.push_back((at, frame.to_vec()));
        } else {
            self.pass(frame.to_vec(), now);
        }
        true
    }

    /// Takes a frame through the segment, and on its way back.
    fn pass(&mut self, mut frame: Vec<u8>, now: Duration) {
        let sent = frame.clone();
        if !self.segment.process(&mut frame, now) {
            return;
        }
        self.show(&sent, &frame);
        if self.hits(self.faults.pass_twice, "pass-twice") {
            let mut again = sent.clone();
            if self.segment.process(&mut again, now) {
                self.show(&sent, &again);
            }
        }
        if self.hits(self.faults.reply_loss, "reply-loss") {
            return;
        }
        self.spoil_messages(&mut frame);
        let whole = frame.clone();
        if self.hits(self.faults.miscount, "miscount") {
            self.miscount(&mut frame);
        }
        if self.hits(self.faults.counter, "counter") {
            self.recount(&mut frame);
        }
        if self.hits(self.faults.flip, "flip") {
            let all = 0..frame.len();
            self.flip_one_of(&mut frame, &all.collect::<Vec<_>>());
        }
        if self.hits(self.faults.flip_header, "flip-header") {
            let headers = datagrams(&frame).into_iter();
            let headers = headers.flat_map(|range| range.start..range.start + DATAGRAM_HEADER);
            let places: Vec<_> = (0..16).chain(headers).collect();
            self.flip_one_of(&mut frame, &places);
        }
        if self.hits(self.faults.flip_data, "flip-data") {
            let data = datagrams(&frame).into_iter();
            let data =
                data.flat_map(|range| range.start + DATAGRAM_HEADER..range.end - WORKING_COUNTER);
            self.flip_one_of(&mut frame, &data.collect::<Vec<_>>());
        }
        if self.hits(self.faults.cut_short, "cut-short") {
            let length = self.between(frame.len() as u64) as usize;
            frame.truncate(length);
        }
        let late = self.delayed(self.faults.late, "late");
        let later = now.saturating_add(self.later()).saturating_add(late);
        if self.hits(self.faults.double, "double") {
            let again = later.saturating_add(self.later());
            self.return_at(again, frame.clone());
        }
        if self.hits(self.faults.foreign, "foreign") {
            let foreign = self.foreign(&sent, &whole);
            self.return_at(later, foreign);
        }
        self.return_at(later, frame);
    }

    /// The next frame that has come back by `now`.
    pub fn receive(&mut self, now: Duration) -> Option<Vec<u8>> {
        self.advance(now);
        let due = self.returning.first().is_some_and(|(at, _)| *at <= now);
        due.then(|| self.returning.remove(0).1)
    }

    /// When the next frame comes back, of those that were sent, or reaches the first SubDevice.
    #[must_use]
    pub fn next_arrival(&self) -> Option<Duration> {
        let returning = self.returning.first().map(|(at, _)| *at);
        let outgoing = self.outgoing.front().map(|(at, _)| *at);
        returning.into_iter().chain(outgoing).min()
    }

    fn return_at(&mut self, at: Duration, frame: Vec<u8>) {
        let behind = self.returning.partition_point(|(other, _)| *other <= at);
        self.returning.insert(behind, (at, frame));
    }

    fn happen(&mut self, what: What, position: usize, now: Duration) {
        let Some(device) = self.segment.device_mut(position) else {
            return;
        };
        let name = match what {
            What::Cut => {
                self.segment.unplug(position);
                "cut"
            }
            What::Power => {
                device.power_off();
                "power"
            }
            What::Freeze => {
                device.freeze(true);
                "freeze"
            }
            What::Fall => {
                device.fall_to(AlState::SafeOp, OWN_FAULT);
                "fall"
            }
            What::Fault => {
                for axis in 0..device.axes().len() {
                    if let Some(axis) = device.axis_mut(axis) {
                        axis.inject_fault(SENSOR_FAULT);
                    }
                }
                "fault"
            }
            What::Plug => return self.segment.plug_in(position),
            What::PowerBack => return device.power_on(now),
            What::Thaw => return device.freeze(false),
            What::Emergencies => {
                for position in 0..self.segment.len() {
                    if let Some(device) = self.segment.device_mut(position) {
                        device.inject_emergency(0xFF00, 0x81, [0; 5], now);
                    }
                }
                let begin = self.begin.unwrap_or(now);
                let next = now
                    .saturating_sub(begin)
                    .saturating_add(self.faults.emergencies);
                let place = self.to_come.partition_point(|(at, ..)| *at > next);
                self.to_come.insert(place, (next, What::Emergencies, 0));
                "emergencies"
            }
        };
        *self.seen.entry(name).or_default() += 1;
    }

    /// Takes one off the working counter of one datagram.
    fn miscount(&mut self, frame: &mut [u8]) {
        let all = datagrams(frame);
        let at = self.between((all.len() as u64).saturating_sub(1)) as usize;
        let counter = all.get(at).and_then(|range| {
            let end = range.end;
            frame.get_mut(end.checked_sub(2)?..end)
        });
        if let Some([low, high]) = counter {
            let counter = u16::from_le_bytes([*low, *high]).saturating_sub(1);
            [*low, *high] = counter.to_le_bytes();
        }
    }

    /// Makes the working counter of one datagram any number, mostly a small one.
    fn recount(&mut self, frame: &mut [u8]) {
        let all = datagrams(frame);
        let at = self.between((all.len() as u64).saturating_sub(1)) as usize;
        let counter = match self.between(2) {
            0 => self.between(3) as u16,
            1 => self.next() as u16,
            _ => 0,
        };
        if let Some(range) = all.get(at)
            && let Some(bytes) = frame.get_mut(range.end - WORKING_COUNTER..range.end)
        {
            bytes.copy_from_slice(&counter.to_le_bytes());
        }
    }

    fn flip_one_of(&mut self, frame: &mut [u8], places: &[usize]) {
        let place = self.one_of(places).copied();
        let bit = self.between(7);
        if let Some(byte) = place.and_then(|place| frame.get_mut(place)) {
            *byte ^= 1 << bit;
        }
    }

    /// A frame that answers nothing: of another protocol, the request itself, an answer of another master, or noise.
    fn foreign(&mut self, sent: &[u8], answer: &[u8]) -> Vec<u8> {
        let mut frame = answer.to_vec();
        let random = match self.between(3) {
            0 => {
                if let Some(ethertype) = frame.get_mut(12..14) {
                    ethertype.copy_from_slice(&[0x08, 0x00]);
                }
                0..0
            }
            1 => return sent.to_vec(),
            2 => 8..12,
            _ => 14..frame.len(),
        };
        for byte in frame.get_mut(random).unwrap_or_default() {
            *byte = self.next() as u8;
        }
        frame
    }

    /// Shows a frame to whoever watches, and keeps what it says of objects.
    fn show(&mut self, sent: &[u8], answer: &[u8]) {
        if let Some(witness) = &mut self.witness {
            witness(sent, answer);
        }
        if self.faults.mail_other == Rate::default() {
            return;
        }
        for (station, message) in answers(answer) {
            let message = answer.get(message).unwrap_or_default();
            if object(message).is_some() {
                self.said.push_back((station, message.to_vec()));
            }
            if self.said.len() > KEPT {
                self.said.pop_front();
            }
        }
    }

    /// What a bad device puts into its mailbox.
    fn spoil_messages(&mut self, frame: &mut [u8]) {
        for (station, range) in answers(frame) {
            let message = frame.get(range.clone()).unwrap_or_default().to_vec();
            let mut other = None;
            if self.hits(self.faults.mail_bits, "mail-bits") {
                let mut bits = message.clone();
                let (at, mask) = match self.between(1) {
                    0 => (5, 0x10 << self.between(2)),
                    _ => (8, 0x10),
                };
                if let Some(byte) = bits.get_mut(at) {
                    *byte ^= mask;
                }
                other = Some(bits);
            }
            if self.hits(self.faults.mail_other, "mail-other") {
                other = self.earlier(station, &message).or(other);
            }
            if self.hits(self.faults.mail_emergency, "mail-emergency") {
                let counter = 1 + self.between(6) as u8;
                let mut emergency = vec![10, 0, 0, 0, 0, COE | counter << 4, 0x00, 0x10];
                emergency.extend([0x00, 0xFF, 0x81, 0, 0, 0, 0, 0]);
                other = Some(emergency);
            }
            if self.hits(self.faults.mail_garbage, "mail-garbage") {
                let mut garbage = message.clone();
                let (from, length) = (self.between(11) as usize, 1 + self.between(9) as usize);
                for byte in garbage.iter_mut().skip(from).take(length) {
                    *byte = self.next() as u8;
                }
                other = Some(garbage);
            }
            let (Some(other), Some(message)) = (other, frame.get_mut(range)) else {
                continue;
            };
            message.fill(0);
            for (to, from) in message.iter_mut().zip(other) {
                *to = from;
            }
        }
    }

    /// An answer that this station gave before, about another object than the one that this one is about: as true as ever, and not
    /// what was asked.
    fn earlier(&mut self, station: u16, message: &[u8]) -> Option<Vec<u8>> {
        // Whose segments these are, they do not say: an answer about any object is another one.
        let about = object(message);
        let is_response = message.get(7).is_some_and(|byte| byte >> 4 == SDO_RESPONSE);
        let others = self.said.iter().filter(|(of, said)| {
            *of == station && is_response && about.is_none_or(|about| object(said) != Some(about))
        });
        let others: Vec<_> = others.map(|(_, said)| said.clone()).collect();
        self.one_of(&others).cloned()
    }

    fn one_of<'a, T>(&mut self, all: &'a [T]) -> Option<&'a T> {
        let last = all.len().checked_sub(1)?;
        let place = self.between(last as u64) as usize;
        all.get(place)
    }

    fn delayed(&mut self, of: Delayed, name: &'static str) -> Duration {
        if !self.hits(of.rate, name) {
            return Duration::ZERO;
        }
        let most = u64::try_from(of.most.as_nanos()).unwrap_or(u64::MAX);
        Duration::from_nanos(self.between(most))
    }

    fn hits(&mut self, rate: Rate, name: &'static str) -> bool {
        let hits = !self.quiet && rate.0 > 0 && self.between(999_999) < u64::from(rate.0);
        if hits {
            *self.seen.entry(name).or_default() += 1;
        }
        hits
    }

    fn later(&mut self) -> Duration {
        let most = u64::try_from(self.faults.delay.as_nanos()).unwrap_or(u64::MAX);
        if most == 0 || self.quiet {
            return Duration::ZERO;
        }
        Duration::from_nanos(self.between(most))
    }

    /// From 0 to `most`.
    fn between(&mut self, most: u64) -> u64 {
        ((u128::from(self.next()) * (u128::from(most) + 1)) >> 64) as u64
    }

    /// Splitmix64.
    fn next(&mut self) -> u64 {
        self.random = self.random.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.random;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }
}

/// The messages by CoE that a frame brings from mailboxes: of which station, and where they are.
fn answers(frame: &[u8]) -> Vec<(u16, core::ops::Range<usize>)> {
    let read = |range: core::ops::Range<usize>| {
        let station = read_u16(frame, range.start + 2)?;
        let is_memory = read_u16(frame, range.start + 4)? >= MEMORY;
        let message = range.start + DATAGRAM_HEADER..range.end - WORKING_COUNTER;
        let is_read = *frame.get(range.start)? == READ && read_u16(frame, message.end)? > 0;
        let is_coe = frame.get(message.start + 5)? & 0x0F == COE;
        let found = is_memory && is_read && is_coe && message.len() >= SHORTEST_MESSAGE;
        found.then_some((station, message))
    };
    datagrams(frame).into_iter().filter_map(read).collect()
}

/// The object that the answer to a first request, or an abort, names.
fn object(message: &[u8]) -> Option<(u16, u8)> {
    let is_response = message.get(7)? >> 4 == SDO_RESPONSE;
    let command = *message.get(8)?;
    let names_it = command >> 5 == 2 || command == 0x60 || command == 0x80;
    let subindex = *message.get(11)?;
    (is_response && names_it).then_some((read_u16(message, 9)?, subindex))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::personality;

    const MS: Duration = Duration::from_millis(1);

    /// A BRD of the AL status.
    fn frame() -> Vec<u8> {
        let mut frame = vec![0xFF; 6];
        frame.extend([0x10; 6]);
        frame.extend([
            0x88, 0xA4, 14, 0x10, 7, 0, 0, 0, 0x30, 0x01, 2, 0, 0, 0, 0, 0, 0, 0,
        ]);
        frame
    }

    fn line(faults: &str, seed: u64) -> FaultyLine {
        let segment = Segment::new()
            .with(personality::akd2g())
            .with(personality::generic());
        let faults: Faults = faults.parse().unwrap();
        FaultyLine::new(segment, &faults.seed(seed)).unwrap()
    }

    /// What comes back in so many milliseconds, one frame each: when, and what.
    fn returned(line: &mut FaultyLine, frames: u64) -> Vec<(Duration, Vec<u8>)> {
        let mut all = Vec::new();
        for number in 0..frames {
            let sent = MS * number as u32;
            line.send(&frame(), sent);
            while let Some(at) = line.next_arrival().filter(|at| *at < sent + MS) {
                all.extend(line.receive(at).map(|frame| (at, frame)));
            }
        }
        all
    }

    #[test]
    fn a_text_gives_each_fault_and_none_gives_none() {
        assert_eq!("".parse(), Ok(Faults::default()));
        let text = "loss=1%, reply-loss=0.05%,delay=200us,cut=2s@1,cut=3s+500ms@0,power=1.5s+1s@0,\
                    mail-delay=5ms,plant=seeded,drift=50ppm,emergencies=1s,late=1%/400ms, hold=0.1% / 12ms,refuse=2%,\
                    pass-twice=3%,foreign=4%,flip-header=5%,flip-data=6%,counter=7%,mail-bits=8%,mail-other=9%,\
                    mail-emergency=10%,mail-garbage=11%";
        let outage = |ms: u32, lasts: Option<u32>, position| Outage {
            at: ms * MS,
            lasts: lasts.map(|ms| ms * MS),
            position,
        };
        let expected = Faults {
            loss: Rate(10_000),
            reply_loss: Rate(500),
            delay: MS / 5,
            cut: vec![outage(2_000, None, 1), outage(3_000, Some(500), 0)],
            power: vec![outage(1_500, Some(1_000), 0)],
            mail_delay: 5 * MS,
            plant: PlantChoice::Seeded,
            drift_ppm: 50,
            emergencies: 1_000 * MS,
            late: Delayed {
                rate: Rate(10_000),
                most: 400 * MS,
            },
            hold: Delayed {
                rate: Rate(1_000),
                most: 12 * MS,
            },
            refuse: Rate(20_000),
            pass_twice: Rate(30_000),
            foreign: Rate(40_000),
            flip_header: Rate(50_000),
            flip_data: Rate(60_000),
            counter: Rate(70_000),
            mail_bits: Rate(80_000),
            mail_other: Rate(90_000),
            mail_emergency: Rate(100_000),
            mail_garbage: Rate(110_000),
            ..Faults::default()
        };
        assert_eq!(text.parse(), Ok(expected));
    }

    #[test]
    fn what_is_no_fault_is_named_with_what_is_known() {
        let error = |text: &str| text.parse::<Faults>().unwrap_err().to_string();
        assert_eq!(
            error("los=1%"),
            "there is no fault \"los\"; known are loss, reply-loss, delay, late, hold, refuse, double, pass-twice, foreign, \
             cut-short, flip, flip-header, flip-data, miscount, counter, cut, power, freeze, fall, fault, mail-delay, \
             mail-bits, mail-other, mail-emergency, mail-garbage, emergencies, plant, drift"
        );
        assert!(error("loss").starts_with("\"loss\" has no value"));
        assert_eq!(error("loss=1%,loss=2%"), "loss stands twice");
        for (text, expected) in [
            ("loss=1", RATE),
            ("loss=101%", RATE),
            ("loss=NaN%", RATE),
            ("late=1%", DELAYED),
            ("hold=1%/5", DELAYED),
            ("delay=5", TIME),
            ("delay=-5ms", TIME),
            ("delay=1e300s", TIME),
            ("cut=2s", OUTAGE),
            ("cut=2@1", OUTAGE),
            ("cut=2s+@1", OUTAGE),
            ("cut=2s@-1", OUTAGE),
            ("plant=soft", PLANT),
            ("drift=50", DRIFT),
            ("drift=1001ppm", DRIFT),
        ] {
            assert!(error(text).ends_with(expected), "{}", error(text));
        }
        let faults: Faults = "cut=1s@7".parse().unwrap();
        let line = FaultyLine::new(Segment::new().with(personality::generic()), &faults);
        assert_eq!(
            line.unwrap_err().to_string(),
            "there is no SubDevice 7: the line has 1, counted from 0"
        );
    }

    #[test]
    fn the_same_seed_meets_the_same_faults_and_another_one_others() {
        let all = "loss=5%,reply-loss=5%,delay=3ms,double=5%,cut-short=5%,flip=5%,miscount=5%,plant=seeded";
        let run = |seed| {
            let mut line = line(all, seed);
            let returned = returned(&mut line, 500);
            (returned, line.seen().clone())
        };
        assert_eq!(run(1), run(1));
        assert_ne!(run(1).0, run(2).0);
        let (_, seen) = run(1);
        for name in [
            "loss",
            "reply-loss",
            "double",
            "cut-short",
            "flip",
            "miscount",
        ] {
            let times = seen.get(name).copied().unwrap_or(0);
            assert!((10..=45).contains(&times), "{name}: {times} of 500");
        }
    }

    #[test]
    fn each_fault_of_a_frame_does_what_it_says() {
        let whole = returned(&mut line("", 1), 1)[0].1.clone();
        let counter = whole.len() - 2;
        assert_eq!(whole[counter], 2);
        assert!(returned(&mut line("loss=100%", 1), 9).is_empty());
        assert!(returned(&mut line("reply-loss=100%", 1), 9).is_empty());
        assert_eq!(returned(&mut line("double=100%", 1), 9).len(), 18);
        for (_, frame) in returned(&mut line("miscount=100%", 1), 9) {
            assert_eq!(frame[counter], 1);
        }
        for (_, frame) in returned(&mut line("flip=100%", 1), 9) {
            let flipped = frame.iter().zip(&whole).map(|(a, b)| (a ^ b).count_ones());
            assert_eq!(flipped.sum::<u32>(), 1);
        }
        for (_, frame) in returned(&mut line("cut-short=100%", 1), 9) {
            assert!(frame.len() <= whole.len());
        }
        let times = returned(&mut line("delay=500us", 1), 50);
        let late = |at: &Duration| at.as_nanos() % 1_000_000;
        assert!(times.iter().all(|(at, _)| late(at) <= 500_000));
        assert!(times.iter().any(|(at, _)| late(at) > 300_000));
    }

    #[test]
    fn bits_are_inverted_where_the_fault_says() {
        let whole = returned(&mut line("", 1), 1)[0].1.clone();
        let data = 26..28;
        for (fault, is_data) in [("flip-header=100%", false), ("flip-data=100%", true)] {
            for (_, frame) in returned(&mut line(fault, 1), 40) {
                let others: Vec<_> = (0..whole.len())
                    .filter(|at| frame[*at] != whole[*at])
                    .collect();
                let [at] = others[..] else {
                    panic!("{fault}: {others:?}");
                };
                assert_eq!((frame[at] ^ whole[at]).count_ones(), 1);
                assert_eq!(data.contains(&at), is_data, "{fault}: {at}");
                assert!(at < 28, "{fault}: {at}");
            }
        }
        let counters = returned(&mut line("counter=100%", 1), 60);
        let mut counters: Vec<_> = counters
            .iter()
            .map(|(_, frame)| frame[28..].to_vec())
            .collect();
        counters.sort();
        counters.dedup();
        assert!(counters.len() > 10, "{counters:?}");
    }

    #[test]
    fn frames_are_late_held_up_refused_and_beside_foreign_ones() {
        let numbered = |number: u8| {
            let mut frame = frame();
            frame[17] = number;
            frame
        };
        let run = |faults: &str| {
            let mut line = line(faults, 3);
            let mut all = Vec::new();
            for number in 0..40 {
                assert!(line.send(&numbered(number), MS * u32::from(number)));
            }
            while let Some(at) = line.next_arrival() {
                all.extend(line.receive(at).map(|frame| (at, frame)));
            }
            all
        };
        let late = run("late=50%/400ms");
        assert_eq!(late.len(), 40);
        assert!(late.iter().any(|(at, _)| *at > 200 * MS));
        assert!(!late.iter().map(|(_, frame)| frame[17]).is_sorted());
        let held = run("hold=20%/12ms");
        assert_eq!(held.len(), 40);
        assert!(held.iter().map(|(_, frame)| frame[17]).is_sorted());
        let ahead = |(at, frame): &(Duration, Vec<u8>)| *at - MS * u32::from(frame[17]);
        assert!(held.iter().any(|one| ahead(one) > 6 * MS));
        assert!(held.iter().any(|one| ahead(one) < MS));
        let beside = run("foreign=100%");
        assert_eq!(beside.len(), 80);
        let answers = beside
            .iter()
            .filter(|(_, frame)| frame[28] == 2 && frame[12] == 0x88);
        assert!((40..80).contains(&answers.count()), "others answer nothing");
        assert!(!line("refuse=100%", 1).send(&frame(), MS));
        let seen = std::sync::Arc::new(std::sync::Mutex::new(0));
        let mut twice = line("pass-twice=100%,reply-loss=100%", 1);
        let count = std::sync::Arc::clone(&seen);
        twice.watch(move |sent, answer| {
            assert_eq!((sent[28], answer[28]), (0, 2));
            *count.lock().unwrap() += 1;
        });
        assert!(returned(&mut twice, 5).is_empty());
        assert_eq!(*seen.lock().unwrap(), 10);
        let mut quiet = line("loss=100%,delay=5ms,refuse=100%", 1);
        quiet.set_quiet(true);
        assert_eq!(returned(&mut quiet, 5).len(), 5);
        quiet.send(&frame(), 9 * MS);
        quiet.forget();
        assert_eq!(quiet.next_arrival(), None);
    }

    /// An FPRD of the mailbox of station 1000h with an answer about this object.
    fn message(object: u16) -> Vec<u8> {
        let mut frame = frame();
        frame.truncate(16);
        frame[14] = 28;
        frame.extend([4, 1, 0x00, 0x10, 0x80, 0x10, 16, 0, 0, 0]);
        frame.extend([10, 0, 0, 0, 0, 0x13, 0, 0x30, 0x43]);
        frame.extend(object.to_le_bytes());
        frame.extend([0, 1, 2, 3, 4, 1, 0]);
        frame
    }

    #[test]
    fn messages_of_devices_are_spoiled_and_the_frame_around_them_is_not() {
        let spoiled = |fault: &str| {
            let mut line = line(fault, 1);
            line.show(&[], &message(0x1018));
            let mut frame = message(0x1008);
            line.spoil_messages(&mut frame);
            assert_eq!(frame[..26], message(0x1008)[..26], "{fault}");
            assert_eq!(frame[42..], [1, 0], "{fault}");
            frame
        };
        assert_eq!(spoiled(""), message(0x1008));
        assert_eq!(spoiled("mail-other=100%"), message(0x1018));
        let emergency = spoiled("mail-emergency=100%");
        assert_eq!(emergency[33] >> 4, 1, "the service of an emergency");
        assert_eq!(emergency[34..37], [0x00, 0xFF, 0x81]);
        assert_ne!(spoiled("mail-garbage=100%"), message(0x1008));
        let bits = spoiled("mail-bits=100%");
        let inverted = bits
            .iter()
            .zip(message(0x1008))
            .map(|(a, b)| (a ^ b).count_ones());
        assert_eq!(inverted.sum::<u32>(), 1);
        // An answer about the same object is none about another one.
        let mut line = line("mail-other=100%", 1);
        line.show(&[], &message(0x1008));
        let mut frame = message(0x1008);
        line.spoil_messages(&mut frame);
        assert_eq!(frame, message(0x1008));
    }

    #[test]
    fn outages_come_at_their_time_and_end_with_it() {
        let counters = |faults: &str| {
            let mut all = String::new();
            let mut line = line(faults, 1);
            for (at, frame) in returned(&mut line, 10) {
                assert!(at < 10 * MS);
                all += &frame[frame.len() - 2].to_string();
            }
            all
        };
        assert_eq!(counters("cut=3ms@1"), "2221111111");
        assert_eq!(counters("cut=3ms+4ms@1"), "2221111222");
        assert_eq!(counters("power=3ms+2ms@1,power=7ms+1ms@1"), "2221122122");
        assert_eq!(counters("cut=3ms+2ms@0"), "22222222", "nothing returns");
    }

    #[test]
    fn devices_fall_freeze_and_fault_and_are_healed() {
        let mut line = line(
            "freeze=1ms@0,fault=2ms@1,emergencies=1ms,power=4ms@1,cut=5ms@0",
            1,
        );
        returned(&mut line, 4);
        let state = |line: &FaultyLine| line.segment().axis(1, 0).unwrap().state();
        assert!(format!("{:?}", state(&line)).starts_with("Fault"));
        assert_eq!(returned(&mut line, 0).len(), 0);
        line.advance(6 * MS);
        assert!(!line.segment().device(1).unwrap().is_powered());
        for name in ["freeze", "fault", "power", "cut"] {
            assert_eq!(line.seen().get(name), Some(&1), "{name}");
        }
        assert!(
            line.seen()
                .get("emergencies")
                .is_some_and(|times| *times >= 5)
        );
        line.heal(7 * MS);
        line.send(&frame(), 8 * MS);
        let frame = line.receive(8 * MS).unwrap();
        assert_eq!(frame[frame.len() - 2], 2);
        assert!(line.segment().device(1).unwrap().is_powered());
    }
}
