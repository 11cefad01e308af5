//! What happens to the devices of a line in the course of a scenario.

use std::{collections::BTreeMap, rc::Rc, time::Duration};

use servocrab_sim::{Abort, AlState, Faults, Habits, Rate};

use crate::{
    cable::Wired,
    program::{Common, MS, Times},
    random::Random,
};

/// AL status codes with which devices fall: a fault of their own, the watchdog, the synchronisation.
const CODES: [u16; 4] = [0x0001, 0x001B, 0x001A, 0x8001];

/// Makes trouble until it is told to end.
pub struct FaultDriver {
    random: Random,
    wired: Wired,
    /// What the drives' numbers are, by their position.
    drives: BTreeMap<usize, usize>,
    without_power: Times,
    stood: Times,
    /// From one trouble to the next, in milliseconds at most.
    often_ms: u64,
    next: Duration,
    weather_until: Duration,
    power_back: Vec<(Duration, usize)>,
    plug_back: Option<Duration>,
    thaw: Vec<(Duration, usize)>,
    /// How often each has happened.
    pub seen: BTreeMap<&'static str, u64>,
}

/// Faults of the cable and of what devices say, as a seed has them.
pub fn faults(random: &mut Random, seed: u64) -> Faults {
    let often = random.one_of(&[300, 3_000, 30_000, 200_000]);
    let mut rate = |once_in| {
        let chosen = random.once_in(once_in);
        let millionths = random.between(1, often) as u32;
        Rate::per_million(if chosen { millionths } else { 0 })
    };
    // What lies makes other checks impossible: it is in one scenario of four.
    let (flip_data, mail_garbage) = (rate(8), rate(8));
    let mut faults = Faults {
        seed,
        loss: rate(3),
        reply_loss: rate(3),
        refuse: rate(3),
        double: rate(3),
        pass_twice: rate(3),
        foreign: rate(3),
        cut_short: rate(3),
        flip_header: rate(3),
        flip_data,
        miscount: rate(3),
        counter: rate(3),
        mail_bits: rate(3),
        mail_other: rate(3),
        mail_emergency: rate(3),
        mail_garbage,
        ..Faults::default()
    };
    (faults.late.rate, faults.hold.rate) = (rate(3), rate(3));
    faults.late.most = random.one_of(&[9 * MS, 400 * MS]);
    faults.hold.most = 12 * MS;
    // Later frames overtake.
    faults.delay = random.one_of(&[Duration::ZERO, Duration::ZERO, MS * 3 / 20]);
    faults
}

impl FaultDriver {
    pub fn new(seed: u64, wired: &Wired, drives: BTreeMap<usize, usize>, common: &Common) -> Self {
        let mut random = Random::new(seed ^ 0x7472_6F75);
        Self {
            often_ms: random.one_of(&[50, 300, 1_500]),
            random,
            wired: wired.clone(),
            drives,
            without_power: Rc::clone(&common.without_power),
            stood: Rc::clone(&common.stood),
            next: Duration::ZERO,
            weather_until: Duration::ZERO,
            power_back: Vec::new(),
            plug_back: None,
            thaw: Vec::new(),
            seen: BTreeMap::new(),
        }
    }

    fn ms(&mut self, most: u64) -> Duration {
        MS * self.random.between(1, most) as u32
    }

    pub fn act(&mut self, now: Duration) {
        self.undo(now);
        if now >= self.weather_until {
            self.weather_until = now + self.ms(400);
            let quiet = self.random.once_in(3);
            self.wired.line().set_quiet(quiet);
        }
        if now < self.next {
            return;
        }
        self.next = now + self.ms(self.often_ms);
        self.make(now);
    }

    fn undo(&mut self, now: Duration) {
        if self.plug_back.is_some_and(|at| at <= now) {
            self.plug_back = None;
            self.wired.line().segment_mut().plug();
        }
        let due = |list: &mut Vec<(Duration, usize)>| {
            let due: Vec<_> = list.iter().filter(|(at, _)| *at <= now).copied().collect();
            list.retain(|(at, _)| *at > now);
            due
        };
        for (_, device) in due(&mut self.power_back) {
            self.switch_on(now, device);
        }
        for (_, device) in due(&mut self.thaw) {
            let mut line = self.wired.line();
            let segment = line.segment_mut();
            segment.device_mut(device).unwrap().freeze(false);
            if let Some(drive) = self.drives.get(&device) {
                self.stood.borrow_mut().insert(*drive, now);
            }
        }
    }

    fn switch_on(&mut self, now: Duration, device: usize) {
        let mut line = self.wired.line();
        let segment = line.segment_mut();
        segment.device_mut(device).unwrap().power_on(now);
        if let Some(drive) = self.drives.get(&device) {
            self.without_power.borrow_mut().insert(*drive, now);
        }
    }

    fn make(&mut self, now: Duration) {
        let wired = self.wired.clone();
        let mut line = wired.line();
        let segment = line.segment_mut();
        let count = segment.len() as u64;
        let at = self.random.below(count) as usize;
        let code = self.random.one_of(&CODES);
        let device = segment.device_mut(at).unwrap();
        let what = match self.random.below(11) {
            0 => {
                device.fall_to_safe_op(code);
                "falls to SAFEOP"
            }
            1 => {
                let states = [AlState::PreOp, AlState::Init, AlState::Op];
                device.fall_to(self.random.one_of(&states), code);
                "falls"
            }
            2 if device.is_powered() => {
                device.power_off();
                if let Some(drive) = self.drives.get(&at) {
                    self.without_power.borrow_mut().insert(*drive, now);
                }
                let back = now + self.ms(500);
                self.power_back.push((back, at));
                "loses its power"
            }
            3 if self.plug_back.is_none() => {
                segment.unplug(at);
                self.plug_back = Some(now + self.ms(400));
                "is unplugged"
            }
            4 => {
                device.freeze(true);
                if let Some(drive) = self.drives.get(&at) {
                    self.stood.borrow_mut().insert(*drive, now);
                }
                let thaw = now + self.ms(300);
                self.thaw.push((thaw, at));
                "is frozen"
            }
            5 | 6 => {
                let (random, states) = (&mut self.random, [AlState::SafeOp, AlState::Op]);
                let late = MS * random.between(1, 1_400) as u32;
                let to = random.one_of(&[AlState::Init, AlState::PreOp, AlState::SafeOp]);
                let habits = Habits {
                    late: random.once_in(2).then(|| (random.below(20), late)),
                    emergencies: random.once_in(3),
                    refuses: random.once_in(3).then(|| (random.below(60), Abort::Access)),
                    falls: random
                        .once_in(3)
                        .then(|| (random.one_of(&states), to, code)),
                    ..Habits::default()
                };
                device.set_habits(habits);
                "has habits"
            }
            7 => {
                let delay = Duration::from_micros(self.random.below(5_000));
                device.set_mailbox_delay(delay);
                "has a slow mailbox"
            }
            8 => {
                for _ in 0..self.random.between(1, 12) {
                    device.inject_emergency(0xFF00, 0x81, [0; 5], now);
                }
                "sends emergencies"
            }
            9 if !device.axes().is_empty() => {
                let axis = self.random.below(device.axes().len() as u64) as usize;
                device.axis_mut(axis).unwrap().inject_fault(0x7500);
                "has a fault"
            }
            _ => {
                device.set_habits(Habits::default());
                "behaves"
            }
        };
        tracing::debug!(at = ?now, device = at, what);
        *self.seen.entry(what).or_default() += 1;
    }

    /// Everything is well from now on.
    pub fn end(&mut self, now: Duration) {
        for (_, device) in std::mem::take(&mut self.power_back) {
            self.switch_on(now, device);
        }
        let mut line = self.wired.line();
        let segment = line.segment_mut();
        segment.plug();
        for at in 0..segment.len() {
            let device = segment.device_mut(at).unwrap();
            device.freeze(false);
            device.set_habits(Habits::default());
            device.set_mailbox_delay(Duration::ZERO);
        }
        line.set_quiet(true);
    }
}
