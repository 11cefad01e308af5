//! Keeps the cycles in step with the reference clock: the frames of the process data pass it when its time is a multiple of
//! the cycle.
//!
//! A proportional-integral controller moves the start of the next cycle by a sixteenth of the phase error, and by an
//! integral that takes up the difference of the two crystals (a gain of 1/1024, critically damped). Its bandwidth (−3 dB) is
//! 1/80 of the cycle's frequency: 12 Hz at 1 ms. How late this thread woke up is known, and left out of the error: the
//! schedule follows the clock, not the operating system.

use std::{ops::Range, time::Duration};

use crate::{
    bus::{
        cycle::frame::{Composer, DATAGRAM_HEADER, DATAGRAM_OVERHEAD, command},
        error::ReferenceClock,
    },
    esc,
};

/// Binary places of the integral: it is a gain of 1/1024.
const PLACES: u32 = 10;
/// The proportional gain of 1/16, in these places.
const PROPORTIONAL: i64 = 1 << (PLACES - 4);
/// Crystals that differ by more than this many parts per million are not followed. Two of 100 ppm differ by 200.
const MOST_PPM: i64 = 500;
/// Cycles in a row within the bound that make a lock; and so many without the reference's time end it.
pub(in crate::bus) const LOCK_CYCLES: u32 = 64;
/// What a cycle beyond the bound takes from a lock: some of them end it.
const BEYOND: u32 = 16;
/// So many cycles in a row that are more than half a cycle off are no wild values: the reference clock has jumped.
const JUMP_CYCLES: u32 = 8;

/// The phase error that a lock keeps: a fiftieth of the cycle.
pub(in crate::bus) fn bound(period: Duration) -> Duration {
    period / 50
}

/// The controller alone: errors in, corrections out, both in nanoseconds.
#[derive(Debug, Clone, Copy, Default)]
struct Controller {
    /// In parts of 1/1024 ns.
    integral: i64,
    /// What has been left over by whole nanoseconds, in the same parts.
    rest: i64,
}

impl Controller {
    /// By how much the next cycle is to start sooner, from how much later than wanted this one was.
    fn step(&mut self, error: i64, most: i64) -> i64 {
        self.integral = (self.integral + error).clamp(-most, most);
        let wanted = error * PROPORTIONAL + self.integral + self.rest;
        let correction = wanted >> PLACES;
        self.rest = wanted - (correction << PLACES);
        correction
    }

    /// By how much the crystals differ in so many cycles.
    fn drift(&self, cycles: i64) -> i64 {
        self.integral.saturating_mul(cycles) >> PLACES
    }
}

/// The phase of the cycles against the reference clock.
#[derive(Debug, Clone)]
pub(in crate::bus) struct Phase {
    period: i64,
    /// The system time at which the frames of the next cycle are to pass the reference clock; a multiple of the period.
    next: u64,
    /// The same of this cycle, and how much later it began than was planned.
    now: (u64, i64),
    controller: Controller,
    bound: i64,
    /// Whether the first error has been taken away.
    has_begun: bool,
    /// Up to twice as many cycles as make a lock.
    within: u32,
    /// Whether there has been a lock.
    has_locked: bool,
    /// Cycles in a row without the reference's time.
    silent: u32,
    /// Cycles in a row that were more than half a cycle off.
    wild: u32,
    has_jumped: bool,
}

/// What one cycle has shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) struct Measured {
    /// By how much later than wanted the frames passed the reference clock, in nanoseconds.
    pub error: i64,
    /// Whether the phase is locked.
    pub locked: bool,
    /// Whether the error is within the bound.
    pub within: bool,
    /// What the reference clock does.
    pub reference: ReferenceClock,
}

impl Phase {
    /// Cycles of this period, the first of which is to pass the reference clock at the system time `first`, rounded up to a
    /// multiple of the period: the phase, and by how much later than `first` that is.
    pub fn starting_at(first: u64, period: Duration) -> (Self, Duration) {
        let length = nanoseconds(period).max(1);
        let ahead = to_multiple(first, length.cast_unsigned());
        let next = first.wrapping_add(ahead);
        let phase = Self {
            period: length,
            next,
            now: (next, 0),
            controller: Controller::default(),
            bound: nanoseconds(bound(period)),
            has_begun: false,
            within: 0,
            has_locked: false,
            silent: 0,
            wild: 0,
            has_jumped: false,
        };
        (phase, Duration::from_nanos(ahead))
    }

    /// A cycle begins, so much later than planned, and with the next one the plan goes on after `periods` periods. The
    /// system time at which its frames pass the reference clock, as far as is known, and by how much sooner than after
    /// `periods` periods the next one is to start, in nanoseconds: the crystals differ in those that are left out too.
    pub fn begin(&mut self, late: Duration, periods: u32) -> (u64, i64) {
        let late = nanoseconds(late);
        let drift = self.controller.drift(periods.saturating_sub(1).into());
        self.now = (self.next.wrapping_add_signed(drift), late);
        let length = self.period.saturating_mul(periods.into());
        self.next = self.next.wrapping_add_signed(length);
        (self.now.0.wrapping_add_signed(late), drift)
    }

    /// The system time at which this cycle was to pass the reference clock.
    pub const fn time(&self) -> u64 {
        self.now.0
    }

    /// Whether the cycles are in step.
    pub const fn is_locked(&self) -> bool {
        self.within >= LOCK_CYCLES && !self.has_jumped
    }

    /// What the reference clock does.
    pub const fn reference(&self) -> ReferenceClock {
        if self.has_jumped {
            ReferenceClock::Jumped
        } else if self.silent >= LOCK_CYCLES {
            ReferenceClock::Silent
        } else {
            ReferenceClock::Heard
        }
    }

    /// The frames of the cycle are back, with the low half of the reference clock's time. By how much sooner than planned the
    /// next cycle is to start, in nanoseconds, and what was seen. Without a time, and with one that cannot be, the crystals
    /// are held as they were; for good once the reference has jumped.
    pub fn end(&mut self, time: Option<u32>) -> (i64, Option<Measured>) {
        let most = (self.period * MOST_PPM / 1_000_000) << PLACES;
        let Some(time) = time.filter(|_| !self.has_jumped) else {
            self.silent = self.silent.saturating_add(1);
            self.within = self.within.saturating_sub(1);
            return (self.controller.step(0, most), None);
        };
        self.silent = 0;
        let (wanted, late) = self.now;
        // Of the plan, without what was late in this cycle alone: that may be longer than 32 bits of nanoseconds.
        let passes = wanted.wrapping_add_signed(late);
        let of_plan = i64::from(time.wrapping_sub(passes as u32).cast_signed());
        let error = of_plan.saturating_add(late);
        self.within = match of_plan.abs() {
            error if error <= self.bound => (self.within + 1).min(2 * LOCK_CYCLES),
            _ if !self.is_locked() => 0,
            error if error <= self.period / 2 => self.within.saturating_sub(BEYOND),
            // No news of the phase.
            _ => self.within.saturating_sub(1),
        };
        let correction = self.correct(of_plan, most);
        let measured = Measured {
            error,
            locked: self.is_locked(),
            within: error.abs() <= self.bound,
            reference: self.reference(),
        };
        self.has_locked |= measured.locked;
        (correction, Some(measured))
    }

    /// By how much sooner than planned the next cycle is to start, from how much later than planned this one passed.
    fn correct(&mut self, of_plan: i64, most: i64) -> i64 {
        if !self.has_begun {
            // The first plan was made from a time that was read by another frame: whole cycles between do not matter.
            self.has_begun = true;
            let half = self.period / 2;
            let rest = (of_plan + half).rem_euclid(self.period) - half;
            self.next = self.next.wrapping_add_signed(of_plan - rest);
            return rest;
        }
        if of_plan.abs() <= self.period / 2 {
            self.wild = 0;
            // A single wild value must not throw the phase about.
            let limit = self.period / 16;
            return self.controller.step(of_plan.clamp(-limit, limit), most);
        }
        // No slip of this side's is so long: the time cannot be right, or the clock is another one than it was. SYNC0 of all
        // drives lies on the grid of the one before.
        self.wild += 1;
        if self.wild >= JUMP_CYCLES {
            self.wild = 0;
            self.has_jumped = self.has_locked;
            self.has_begun = self.has_locked;
        }
        self.controller.step(0, most)
    }
}

/// From a time to the next multiple of `length`, which is not 0.
pub(in crate::bus) const fn to_multiple(time: u64, length: u64) -> u64 {
    (length - time % length) % length
}

/// The time whose low half this is, nearest to an estimate.
pub(in crate::bus) fn extend(estimate: u64, low: u32) -> u64 {
    let difference = low.wrapping_sub(estimate as u32).cast_signed();
    estimate.wrapping_add_signed(difference.into())
}

fn nanoseconds(duration: Duration) -> i64 {
    i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX)
}

// The datagram that reads the reference clock's time and gives it to all others: FRMW of register 0910h, the low half, which
// is what the clocks compare (ESC data sheet, section I, 9.1.5). While the cycles lead it is a BWR of the cycles' own time.

const BYTES: usize = 4;
/// What the datagram takes of the first frame.
pub(in crate::bus) const RESERVED: usize = DATAGRAM_OVERHEAD + BYTES;

/// Whose time is given to all others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) struct Distribution {
    /// Station address of the reference clock.
    pub station: u16,
}

/// By how many nanoseconds what is sent goes up and down from cycle to cycle: no clock in step does that.
const RIPPLE: u32 = 8;
/// What comes back as it was sent so often in a row was not read from a clock.
const ECHOES: u32 = 4;

/// The datagram in the first frame of the exchange.
#[derive(Debug, Clone)]
pub(in crate::bus) struct Slot {
    data: Range<usize>,
    distribution: Distribution,
    /// Whether all clocks get the time that is put in, the reference among them.
    leads: bool,
    ripple: u32,
    sent: u32,
    /// How often in a row came back what was sent.
    echoes: u32,
}

impl Slot {
    /// Adds it to a frame.
    pub fn push(composer: &mut Composer, distribution: Distribution) -> Self {
        let [s0, s1] = distribution.station.to_le_bytes();
        let [r0, r1] = esc::SYSTEM_TIME.to_le_bytes();
        Self {
            data: composer.push(command::FRMW, [s0, s1, r0, r1], BYTES),
            distribution,
            leads: false,
            ripple: 0,
            sent: 0,
            echoes: ECHOES,
        }
    }

    /// Puts the time in at which the frame will pass the reference clock, as far as is known: where the reference is gone,
    /// that is what the others get.
    pub fn fill(&mut self, request: &mut [u8], time: u32) {
        self.ripple ^= RIPPLE;
        self.sent = time.wrapping_add(self.ripple);
        if let Some(data) = request.get_mut(self.data.clone()) {
            data.copy_from_slice(&self.sent.to_le_bytes());
        }
        // Here and not when that changes: a frame that is on its way is compared with what was sent.
        let start = self.data.start.checked_sub(DATAGRAM_HEADER);
        let header = start.and_then(|start| request.get_mut(start..self.data.start));
        if let Some([command, _, s0, s1, ..]) = header {
            let (sent_as, station) = if self.leads {
                (command::BWR, 0)
            } else {
                (command::FRMW, self.distribution.station)
            };
            *command = sent_as;
            [*s0, *s1] = station.to_le_bytes();
        }
    }

    /// The time that the reference clock put into the frame that came back, if it did. The working counter does not show it: a
    /// SubDevice that was switched off and on has lost its station address, and takes the time like all others.
    pub fn read(&mut self, answer: Option<&[u8]>) -> Option<u32> {
        if self.leads {
            return None;
        }
        let data = answer.and_then(|answer| answer.get(self.data.clone()));
        let time = data.and_then(|data| Some(u32::from_le_bytes(data.try_into().ok()?)));
        self.echoes = match time {
            None => ECHOES,
            Some(time) if time == self.sent => self.echoes.saturating_add(1),
            Some(_) => 0,
        };
        // A clock in step may show by chance what was sent, and what was sent is where it should be.
        time.filter(|_| self.echoes < ECHOES)
    }

    /// From the next frame on all clocks get the time that is put in, the reference among them (BWR).
    pub const fn lead(&mut self) {
        self.leads = true;
        self.echoes = ECHOES;
    }

    /// From the next frame on all clocks get the reference's time.
    pub const fn follow(&mut self) {
        self.leads = false;
    }

    /// Whether all clocks get the time that is put in.
    pub const fn leads(&self) -> bool {
        self.leads
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_millis(1);

    /// Cycles against a reference clock that is so much too fast: the error of each, in nanoseconds.
    struct Run {
        phase: Phase,
        /// The master's time of the next start.
        start: f64,
        /// What the reference clock shows beside the master's time.
        reference: Box<dyn Fn(f64) -> f64>,
    }

    impl Run {
        fn new(reference: impl Fn(f64) -> f64 + 'static) -> Self {
            let first = reference(0.0) as u64;
            let (phase, ahead) = Phase::starting_at(first, PERIOD);
            Self {
                phase,
                start: ahead.as_nanos() as f64,
                reference: Box::new(reference),
            }
        }

        /// A cycle that wakes so late.
        fn cycle(&mut self, late_ns: f64) -> Measured {
            self.begin(Duration::from_nanos(late_ns as u64), 1);
            let time = (self.reference)(self.start + late_ns) as u64;
            let (sooner, measured) = self.phase.end(Some(time as u32));
            self.start += 1e6 - sooner as f64;
            measured.unwrap()
        }

        fn begin(&mut self, late: Duration, periods: u32) {
            let (_, sooner) = self.phase.begin(late, periods);
            self.start -= sooner as f64;
        }

        /// Wakes so many whole periods late, and half of one.
        fn sleep(&mut self, periods: u32) -> i64 {
            let late = PERIOD * periods + PERIOD / 2;
            let woken = self.start + late.as_nanos() as f64;
            self.begin(late, periods + 1);
            let (sooner, _) = self.phase.end(Some((self.reference)(woken) as u64 as u32));
            self.start += 1e6 * f64::from(periods + 1) - sooner as f64;
            self.cycle(0.0).error
        }

        fn cycles(&mut self, count: usize) {
            for _ in 0..count {
                self.cycle(0.0);
            }
        }
    }

    fn drifting(ppm: f64) -> impl Fn(f64) -> f64 {
        move |time| 7.3e9 + time * (1.0 + ppm * 1e-6)
    }

    #[test]
    fn it_locks_to_a_clock_that_is_100_ppm_off_and_stays_within_a_tenth_of_the_bound() {
        for ppm in [100.0, -100.0, 200.0, -200.0] {
            let mut run = Run::new(drifting(ppm));
            let locked = (0..200).position(|_| run.cycle(0.0).locked);
            assert!(locked.is_some(), "{ppm}");
            for _ in 0..10_000 {
                let seen = run.cycle(0.0);
                assert!(seen.locked && seen.error.abs() < 2_000, "{ppm}: {seen:?}");
            }
            let last = run.cycle(0.0).error;
            assert!(last.abs() <= 2, "{ppm}: {last}");
        }
    }

    #[test]
    fn the_first_error_is_taken_away_at_once() {
        let mut run = Run::new(drifting(0.0));
        run.start += 300_000.0;
        assert_eq!(run.cycle(0.0).error, 300_000);
        assert!(run.cycle(0.0).error.abs() < 300);
    }

    #[test]
    fn a_late_wake_up_moves_nothing() {
        let mut run = Run::new(drifting(50.0));
        run.cycles(1_000);
        assert_eq!(run.cycle(60_000.0).error / 1_000, 60);
        assert!(run.cycle(0.0).error.abs() < 10);
    }

    #[test]
    fn cycles_that_were_slept_through_keep_the_phase() {
        let mut run = Run::new(drifting(0.0));
        run.cycles(100);
        let error = run.sleep(2);
        assert!(error.abs() < 5, "{error}");
    }

    #[test]
    fn crystals_differ_in_the_cycles_that_were_slept_through_too() {
        for ppm in [200.0, -200.0] {
            let mut run = Run::new(drifting(ppm));
            run.cycles(2_000);
            // Without that: 200 us.
            let error = run.sleep(1_000);
            assert!(error.abs() < 200, "{error}");
        }
    }

    #[test]
    fn a_sleep_of_more_than_32_bits_of_nanoseconds_keeps_the_phase() {
        let mut run = Run::new(drifting(0.0));
        run.cycles(200);
        run.begin(Duration::from_millis(5_000), 5_001);
        let time = (run.reference)(run.start + 5e9) as u64;
        let (sooner, measured) = run.phase.end(Some(time as u32));
        assert_eq!((sooner, measured.unwrap().locked), (0, true));
    }

    #[test]
    fn a_clock_at_the_end_of_its_64_bits_is_no_reason_to_panic() {
        let (_, ahead) = Phase::starting_at(u64::MAX - 5, PERIOD);
        assert!(ahead < PERIOD, "{ahead:?}");
    }

    #[test]
    fn without_the_reference_the_crystals_are_held() {
        let mut run = Run::new(drifting(100.0));
        run.cycles(2_000);
        for _ in 0..1_000 {
            run.begin(Duration::ZERO, 1);
            let (sooner, measured) = run.phase.end(None);
            assert_eq!(measured, None);
            run.start += 1e6 - sooner as f64;
        }
        assert_eq!(run.phase.reference(), ReferenceClock::Silent);
        let seen = run.cycle(0.0);
        assert!(seen.error.abs() < 200 && !seen.locked, "{seen:?}");
        assert_eq!(seen.reference, ReferenceClock::Heard);
    }

    #[test]
    fn a_frame_that_is_lost_ends_no_lock_and_errors_that_stay_do() {
        let mut run = Run::new(drifting(0.0));
        run.cycles(1_000);
        run.begin(Duration::ZERO, 1);
        run.phase.end(None);
        run.start += 1e6;
        assert!(run.cycle(0.0).locked);
        // The reference clock has been set to another time.
        run.start += 400_000.0;
        let mut lost = 0;
        while run.cycle(0.0).locked {
            lost += 1;
        }
        assert!((2..8).contains(&lost), "{lost}");
    }

    /// A reference clock that jumps by so many nanoseconds two seconds after the begin.
    fn jumping(by: f64) -> impl Fn(f64) -> f64 {
        let before = drifting(50.0);
        move |time| before(time) + if time < 2e9 { 0.0 } else { by }
    }

    #[test]
    fn a_reference_that_jumps_is_told_and_not_followed() {
        // Up to the ends of 32 bits and beyond them, either way.
        for by in [-7.0e9, -2.2e9, -1.0e9, -0.6e6, 0.6e6, 40.0e6, 2.1e9, 30.0e9] {
            let mut run = Run::new(jumping(by));
            while run.start < 2e9 {
                run.cycle(0.0);
            }
            let before = run.start;
            let told = (1..).find(|_| run.cycle(0.0).reference == ReferenceClock::Jumped);
            assert_eq!(told, Some(JUMP_CYCLES as i32), "{by}");
            for _ in 0..100_000 {
                run.begin(Duration::ZERO, 1);
                let (sooner, measured) = run
                    .phase
                    .end(Some((run.reference)(run.start) as u64 as u32));
                assert_eq!(measured, None);
                run.start += 1e6 - sooner as f64;
            }
            assert!(!run.phase.is_locked());
            // The speed of the crystals is held: 50 ppm.
            let cycles = (run.start - before) / (1e6 * (1.0 - 50e-6));
            assert!((cycles - cycles.round()).abs() < 0.005, "{by}: {cycles}");
        }
    }

    #[test]
    fn a_few_wild_times_move_nothing() {
        let mut run = Run::new(drifting(50.0));
        run.cycles(2_000);
        for wild in [0, 1, u32::MAX, 0x8000_0000, 77, 0, 12_345] {
            run.begin(Duration::ZERO, 1);
            let (sooner, _) = run.phase.end(Some(wild));
            run.start += 1e6 - sooner as f64;
        }
        let seen = run.cycle(0.0);
        assert!(seen.error.abs() < 10, "{seen:?}");
        assert_eq!(seen.reference, ReferenceClock::Heard);
        run.cycles(64);
        assert!(run.cycle(0.0).locked);
    }

    #[test]
    fn a_first_time_that_cannot_be_does_not_make_the_cycles_wait_for_it() {
        let mut run = Run::new(drifting(0.0));
        run.begin(Duration::ZERO, 1);
        let (sooner, _) = run
            .phase
            .end(Some(((run.reference)(run.start) - 2e9) as u64 as u32));
        assert!(sooner.abs() <= 500_000, "{sooner}");
        run.start += 1e6 - sooner as f64;
        // The plan begins again from the times that come, and locks.
        run.cycles(JUMP_CYCLES as usize + LOCK_CYCLES as usize + 1);
        let seen = run.cycle(0.0);
        assert!(seen.locked && seen.error.abs() < 5, "{seen:?}");
    }

    #[test]
    fn half_a_millisecond_is_made_up_for_within_half_a_second() {
        for off in [490_000.0, -490_000.0] {
            let mut run = Run::new(drifting(100.0));
            run.cycles(2_000);
            run.start += off;
            run.cycles(500);
            let seen = run.cycle(0.0);
            assert!(seen.locked && seen.error.abs() < 2_000, "{seen:?}");
        }
    }

    #[test]
    fn the_stated_bandwidth_is_where_the_cycles_follow_by_half_of_the_power() {
        // The reference clock swings by 10 us at 1/80 of the cycle's frequency: what of it do the cycles follow?
        let swing = |time: f64| 10_000.0 * (time / 1e6 / 80.0 * core::f64::consts::TAU).sin();
        let mut run = Run::new(move |time| 1e12 + time + swing(time));
        let mut largest = 0.0_f64;
        for cycle in 0..4_000 {
            let planned = run.start;
            run.cycle(0.0);
            if cycle > 2_000 {
                let ideal = (planned / 1e6).round() * 1e6;
                largest = largest.max((planned - ideal).abs());
            }
        }
        let followed = largest / 10_000.0;
        assert!((0.6..0.85).contains(&followed), "{followed}");
    }

    #[test]
    fn the_low_half_is_extended_to_the_nearest_time() {
        assert_eq!(extend(0x1_0000_0005, 0xFFFF_FFFE), 0xFFFF_FFFE);
        assert_eq!(extend(0xFFFF_FFF0, 5), 0x1_0000_0005);
        assert_eq!(extend(77, 80), 80);
    }
}

#[cfg(test)]
mod distribution_tests {
    use super::*;
    use crate::bus::cycle::frame::BEHIND_TAG;

    fn slot() -> (Slot, Vec<u8>) {
        let mut composer = Composer::new();
        let slot = Slot::push(&mut composer, Distribution { station: 0x1001 });
        (slot, composer.finish())
    }

    #[test]
    fn the_datagram_has_the_bytes_of_the_standard() {
        let (mut slot, mut frame) = slot();
        slot.fill(&mut frame, 0x0403_0201);
        // ETG.1000.4: FRMW is command 14.
        let datagram = [14, 0, 0x01, 0x10, 0x10, 0x09, 4, 0, 0, 0, 9, 2, 3, 4, 0, 0];
        assert_eq!(frame[BEHIND_TAG..], datagram);
        // BWR is command 8; the first SubDevice's position is 0.
        slot.lead();
        slot.fill(&mut frame, 0x0403_0201);
        assert_eq!(frame[BEHIND_TAG..BEHIND_TAG + 6], [8, 0, 0, 0, 0x10, 0x09]);
        assert_eq!(slot.read(Some(&frame[..BEHIND_TAG + 13])), None);
        slot.follow();
        slot.fill(&mut frame, 0x0403_0201);
        assert_eq!(frame[BEHIND_TAG..], datagram);
    }

    #[test]
    fn what_a_clock_shows_is_no_time_of_the_reference_before_it_is_followed_again() {
        let (mut slot, mut frame) = slot();
        slot.fill(&mut frame, 1_000);
        // That frame is on its way.
        slot.lead();
        frame[BEHIND_TAG + 10] ^= 1;
        assert_eq!(slot.read(Some(&frame)), None);
        slot.fill(&mut frame, 2_000);
        slot.follow();
        assert_eq!(slot.read(Some(&frame)), None, "what was sent comes back");
        slot.fill(&mut frame, 3_000);
        frame[BEHIND_TAG + 10] ^= 1;
        assert!(slot.read(Some(&frame)).is_some());
    }

    #[test]
    fn an_echo_is_no_answer_whatever_the_working_counter_says() {
        let (mut slot, mut frame) = slot();
        // Three SubDevices have taken what was sent.
        frame[BEHIND_TAG + 14] = 3;
        let mut heard = |cycles| {
            let echoes = (0..cycles).filter(|cycle| {
                slot.fill(&mut frame, 1_000 * cycle);
                slot.read(Some(&frame)).is_some()
            });
            let heard = echoes.count();
            // The clock answers once.
            frame[BEHIND_TAG + 10] ^= 1;
            assert!(slot.read(Some(&frame)).is_some());
            heard
        };
        assert_eq!(heard(100), 0);
        assert_eq!(heard(100), ECHOES as usize - 1);
    }

    #[test]
    fn a_clock_that_is_exactly_in_step_is_heard_in_each_cycle() {
        let (mut slot, mut frame) = slot();
        for cycle in 0..100 {
            let time = 1_000 * cycle;
            slot.fill(&mut frame, time);
            let mut answer = frame.clone();
            answer[BEHIND_TAG + 10..BEHIND_TAG + 14].copy_from_slice(&time.to_le_bytes());
            assert_eq!(slot.read(Some(&answer)), Some(time));
        }
    }
}
