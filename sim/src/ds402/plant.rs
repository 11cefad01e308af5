//! The plant: what hangs on the drive's demand. A position loop with following error and overshoot, an encoder that
//! dithers, a velocity that is estimated, loads that come and go, and a servo cycle of its own.
//!
//! The trajectory generator gives the demand; the shaft follows it. With `r` as counts by which the shaft is ahead of
//! the demand, `ω` as [`Plant::bandwidth_hz`] times 2π, `ζ` as [`Plant::damping`] and `f` as [`Plant::feed_forward`]:
//!
//! ```text
//! r'' = −ω²·r − 2ζω·r' − 2ζω·(1 − f)·demand velocity − demand acceleration + load
//! ```
//!
//! So the shaft lags by 2ζ(1 − f)·v/ω counts at a constant velocity, and is ahead by a/ω² counts while the demand slows
//! down: by that it runs past the end of each ramp, and comes back within a few 1/ω. The solution is exact for a demand of
//! constant acceleration, however long a step is.
//!
//! | what | unit | [`Plant::default`] | [`Plant::seeded`] |
//! |---|---|---|---|
//! | [`Plant::cycle`] | time | 250 µs | 62.5 µs to 4 ms |
//! | [`Plant::word_cycle`] | time | 0: each drive cycle | 0 to 3 ms |
//! | [`Plant::bandwidth_hz`] | Hz | 40 | 15 to 80 |
//! | [`Plant::damping`] | 1 | 0.9 | 0.5 to 1.5 |
//! | [`Plant::feed_forward`] | share | 0.95 | 0.8 to 1 |
//! | [`Plant::dither`] | counts | ±1 | ±1 to ±3 |
//! | [`Plant::load_step`] | counts | 3 | 0 to 6 |
//! | [`Plant::load_every`] | time | 250 ms | 50 ms to 1 s |
//! | [`Plant::load_recovery`] | time | 10 ms | 5 to 40 ms |
//! | [`Plant::velocity_filter`] | time | 5 ms | 1 to 20 ms |
//! | [`Plant::velocity_step`] | counts/s | 10 | 1 to 100 |
//! | [`Plant::rated_acceleration`] | counts/s² | 50 000 000 | the same |
//! | [`Plant::friction`] | ‰ of rated torque | 30 | 0 to 100 |
//! | [`Plant::start_delay`] | time | 2 ms | 0 to 40 ms, one in eight 150 ms |
//! | [`Plant::standstill_velocity`] | counts/s | 1000 | 500 to 2000 |

use core::f64::consts::TAU;
use core::time::Duration;

use super::wall::Contact;

/// How the shaft of an axis follows its demand, and what the drive measures of it. Every axis has one; [`Plant::ideal`]
/// is the axis that is exactly where its demand is.
///
/// All of it runs in virtual time and from [`Plant::seed`]: the same seed and the same calls give the same counts. The
/// fields can be combined as one likes: an ideal loop with an encoder that dithers is one, too. A value outside its range
/// counts as the nearest one inside.
///
/// ```
/// use core::time::Duration;
/// use servocrab_sim::ds402::{Axis, Behaviour, Plant};
///
/// // A soft loop: it runs past its end, and is back within 30 ms.
/// let plant = Plant { bandwidth_hz: 20.0, ..Plant::default() };
/// let mut axis = Axis::new(Behaviour { plant, ..Behaviour::generic() });
/// axis.set(0x6060, 0, 1)?;
/// axis.set(0x607A, 0, 50_000)?;
/// let (mut now, mut furthest) = (Duration::ZERO, 0);
/// for controlword in [0x00, 0x06, 0x07, 0x0F, 0x1F] {
///     axis.set(0x6040, 0, controlword)?;
///     for _ in 0..400 {
///         now += Duration::from_millis(1);
///         axis.cycle(now);
///         furthest = furthest.max(axis.position());
///     }
/// }
/// assert!(furthest > 50_100 && (axis.position() - 50_000).abs() < 10);
/// # Ok::<(), servocrab_sim::ds402::SetError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plant {
    /// Seed of everything random in it: noise, loads, and where its cycles lie beside those of the bus.
    pub seed: u64,
    /// Cycle of the servo, in which the shaft is measured, within 62.5 µs and 4 ms. It runs beside the drive's own cycle
    /// ([`Behaviour::period`](super::Behaviour::period)): 6064h, 606Ch, 6077h and 60F4h are of its last one, so up to
    /// this much older than 6061h. 0: with each cycle of the drive.
    pub cycle: Duration,
    /// The statusword (6041h) is composed once in this time. 0: in each cycle of the drive.
    pub word_cycle: Duration,
    /// Natural frequency of the position loop in hertz, up to 1000; infinite for a shaft that is where the demand is.
    pub bandwidth_hz: f64,
    /// Damping ratio of the loop, within 0.1 and 5: below 1 the shaft swings around its end.
    pub damping: f64,
    /// How much of the demand velocity is fed forward, within 0 and 1; with 1 there is no following error at a constant
    /// velocity.
    pub feed_forward: f64,
    /// The encoder shows up to this many counts too much or too little, anew in each servo cycle.
    pub dither: u32,
    /// A load step pushes the shaft off by this many counts at most, until the loop has taken it up. Only with power.
    pub load_step: u32,
    /// Mean time from one load step to the next; 0: there are none.
    pub load_every: Duration,
    /// Time constant with which the loop takes a load step up.
    pub load_recovery: Duration,
    /// Time constant of the filter behind 606Ch, which is made of differences of encoder counts. 0: 606Ch is the shaft's
    /// true velocity.
    pub velocity_filter: Duration,
    /// 606Ch is a whole multiple of so many counts/s, before its factor; 0 rounds nothing.
    pub velocity_step: u32,
    /// Counts/s² by the rated torque: 1000 in 6077h. 0: 6077h shows 0 in free motion, and the loop presses against a wall as
    /// hard as the torque limits allow for any following error.
    pub rated_acceleration: u32,
    /// Torque of friction against any motion, in thousandths of the rated one.
    pub friction: u16,
    /// From the cycle that takes a set-point to the begin of its trajectory, where the axis stands: a brake that opens, a
    /// release of the drive's own. Within 10 s.
    pub start_delay: Duration,
    /// The drive takes its axis as standing when the demand stands and the shaft is not faster than this, in counts/s. By
    /// that it ends ramps that lead out of a state, and sets bit 10 after a halt and in Quick stop active.
    pub standstill_velocity: u32,
}

impl Default for Plant {
    /// A stiff loop of a servo with an encoder of a million counts a turn.
    fn default() -> Plant {
        Plant {
            seed: 1,
            cycle: Duration::from_micros(250),
            word_cycle: Duration::ZERO,
            bandwidth_hz: 40.0,
            damping: 0.9,
            feed_forward: 0.95,
            dither: 1,
            load_step: 3,
            load_every: Duration::from_millis(250),
            load_recovery: Duration::from_millis(10),
            velocity_filter: Duration::from_millis(5),
            velocity_step: 10,
            rated_acceleration: 50_000_000,
            friction: 30,
            start_delay: Duration::from_millis(2),
            standstill_velocity: 1_000,
        }
    }
}

impl Plant {
    /// The axis that is exactly where its demand is, measured exactly, in each cycle of the drive: for tests of the words
    /// and the figures of a document.
    #[must_use]
    pub const fn ideal() -> Plant {
        Plant {
            seed: 0,
            cycle: Duration::ZERO,
            word_cycle: Duration::ZERO,
            bandwidth_hz: f64::INFINITY,
            damping: 1.0,
            feed_forward: 1.0,
            dither: 0,
            load_step: 0,
            load_every: Duration::ZERO,
            load_recovery: Duration::ZERO,
            velocity_filter: Duration::ZERO,
            velocity_step: 0,
            rated_acceleration: 0,
            friction: 0,
            start_delay: Duration::ZERO,
            standstill_velocity: 0,
        }
    }

    /// Any plant within the ranges of the table: another one for each seed.
    ///
    /// ```
    /// use servocrab_sim::ds402::Plant;
    ///
    /// assert_eq!(Plant::seeded(7), Plant::seeded(7));
    /// assert_ne!(Plant::seeded(7).bandwidth_hz, Plant::seeded(8).bandwidth_hz);
    /// ```
    #[must_use]
    pub fn seeded(seed: u64) -> Plant {
        let mut random = Noise::new(seed ^ 0x504C_414E_5400);
        let mut pick = |choices: &[u64]| {
            let at = random.below(choices.len() as u64) as usize;
            choices.get(at).copied().unwrap_or(0)
        };
        let micros = Duration::from_micros;
        let millis = Duration::from_millis;
        Plant {
            seed,
            cycle: Duration::from_nanos(pick(&[
                62_500, 125_000, 250_000, 250_000, 400_000, 1_000_000, 1_700_000, 4_000_000,
            ])),
            word_cycle: micros(pick(&[0, 0, 1_500, 3_000])),
            bandwidth_hz: pick(&[15, 20, 30, 40, 60, 80]) as f64,
            damping: pick(&[5, 7, 9, 10, 12, 15]) as f64 / 10.0,
            feed_forward: pick(&[80, 90, 95, 100]) as f64 / 100.0,
            // Together less than the position window of 10 counts that the drives have.
            dither: pick(&[1, 1, 2, 3]) as u32,
            load_step: pick(&[0, 2, 4, 6]) as u32,
            load_every: millis(pick(&[50, 250, 1_000])),
            load_recovery: millis(pick(&[5, 10, 40])),
            velocity_filter: millis(pick(&[1, 5, 20])),
            velocity_step: pick(&[1, 10, 100]) as u32,
            friction: pick(&[0, 30, 100]) as u16,
            start_delay: millis(pick(&[0, 0, 2, 2, 5, 10, 40, 150])),
            standstill_velocity: pick(&[500, 1_000, 2_000]) as u32,
            ..Plant::default()
        }
    }

    /// The same plant with another seed.
    #[must_use]
    pub const fn with_seed(mut self, seed: u64) -> Plant {
        self.seed = seed;
        self
    }

    /// Whether the shaft is where the demand is.
    pub(super) fn is_rigid(&self) -> bool {
        !self.bandwidth_hz.is_finite()
    }

    /// Counts by which loads push the shaft to and fro at rest: less is no motion.
    pub(super) fn rest_band(&self) -> i64 {
        if self.is_rigid() {
            0
        } else {
            2 * i64::from(self.load_step) + 2
        }
    }
}

/// The least and the longest servo cycle, in nanoseconds.
const CYCLES: (u64, u64) = (62_500, 4_000_000);

/// Less than this ahead of a demand that stands, in counts, and slower than this, in counts/s: the shaft stands.
const AT_REST: (f64, f64) = (0.01, 0.5);

/// The plant at work.
#[derive(Debug, Clone)]
pub(super) struct Shaft {
    plant: Plant,
    random: Noise,
    /// Nanoseconds since the last servo cycle and since the statusword was composed.
    since_servo: u64,
    since_word: u64,
    /// Nanoseconds until the next load step.
    until_load: u64,
    /// Counts and counts/s by which the shaft is ahead of the demand.
    ahead: (f64, f64),
    /// Counts/s² of the present load.
    load: f64,
    /// Demand velocity in the last drive cycle and in the last servo cycle, in counts/s.
    velocity_before: f64,
    servo_velocity: f64,
    /// Two lengths of a servo step are met at most, of which one is odd: what each does.
    steps: [Step; 2],
    /// Demand position in the last servo cycle.
    pub(super) demand: f64,
    /// The shaft, in counts and counts/s.
    pub(super) position: f64,
    pub(super) velocity: f64,
    /// The shaft to the nearest count.
    pub(super) counts: i64,
    /// What the encoder shows, in counts.
    pub(super) encoder: i64,
    /// The estimate of the velocity in counts/s, before it is rounded.
    estimate: f64,
    /// 6077h.
    pub(super) torque: i64,
}

/// What the free loop does in one step: a row for the position, a row for the velocity.
#[derive(Debug, Clone, Copy, Default)]
struct Step {
    nanoseconds: u64,
    seconds: f64,
    of_position: (f64, f64),
    of_velocity: (f64, f64),
    /// What is left of a load, and what a difference of positions counts in the estimate.
    load: f64,
    estimate: f64,
}

impl Shaft {
    pub(super) fn at(plant: Plant, position: i64) -> Shaft {
        let mut random = Noise::new(plant.seed);
        let phase =
            |random: &mut Noise, cycle: u64| if cycle == 0 { 0 } else { random.below(cycle) };
        let since_servo = phase(&mut random, servo_cycle(&plant));
        let since_word = phase(&mut random, nanoseconds(plant.word_cycle));
        let mut shaft = Shaft {
            plant,
            random,
            since_servo,
            since_word,
            until_load: 0,
            ahead: (0.0, 0.0),
            load: 0.0,
            velocity_before: 0.0,
            servo_velocity: 0.0,
            steps: [Step::default(); 2],
            demand: position as f64,
            position: position as f64,
            velocity: 0.0,
            counts: position,
            encoder: position,
            estimate: 0.0,
            torque: 0,
        };
        shaft.until_load = shaft.time_to_load();
        shaft
    }

    /// Another plant from now on, from where the shaft is.
    pub(super) fn change(&mut self, plant: Plant) {
        let mut other = Shaft::at(plant, 0);
        other.demand = self.demand;
        other.position = self.position;
        other.velocity = self.velocity;
        other.counts = self.counts;
        other.encoder = self.counts;
        other.velocity_before = self.velocity_before;
        other.servo_velocity = self.servo_velocity;
        if !plant.is_rigid() {
            other.ahead = (
                self.position - self.demand,
                self.velocity - self.servo_velocity,
            );
        }
        *self = other;
    }

    /// One drive cycle of `period`, after which the demand is at `position` with `velocity`. `held`: the shaft does not
    /// turn. `contact` is what acts on it, `reach` is how far the shaft gets for a position, in counts.
    pub(super) fn follow(
        &mut self,
        period: Duration,
        (position, velocity): (f64, f64),
        powered: bool,
        held: bool,
        contact: Contact,
        reach: impl Fn(i64) -> i64,
    ) {
        let period = nanoseconds(period);
        let before = core::mem::replace(&mut self.velocity_before, velocity);
        let cycle = servo_cycle(&self.plant);
        let (elapsed, late) = if cycle == 0 {
            (period, 0)
        } else {
            self.since_servo = self.since_servo.saturating_add(period);
            let late = self.since_servo % cycle;
            let elapsed = self.since_servo - late;
            if elapsed == 0 {
                return;
            }
            self.since_servo = late;
            (elapsed, late)
        };
        // The demand at the servo's instant, which lies within this drive cycle.
        let (mut demand, mut demand_velocity) = (position, velocity);
        if late > 0 {
            let late = late as f64 * 1e-9;
            let acceleration = (velocity - before) / (period as f64 * 1e-9);
            demand -= (velocity - acceleration * late * 0.5) * late;
            demand_velocity -= acceleration * late;
        }
        let step = self.step(elapsed, cycle);
        let old = self.position;
        self.demand = demand;
        if held {
            self.ahead = (old - demand, -demand_velocity);
        } else if self.plant.is_rigid() {
            self.ahead = (0.0, 0.0);
        } else if powered {
            self.run_loop(step, demand_velocity);
        } else {
            self.ahead = (0.0, 0.0);
            self.load = 0.0;
        }
        self.servo_velocity = demand_velocity;
        self.position = demand + self.ahead.0;
        self.velocity = demand_velocity + self.ahead.1;
        let counts = self.position.round() as i64;
        let reached = reach(counts);
        if reached != counts {
            self.position = reached as f64;
            self.velocity = 0.0;
            // It leans against the end.
            if !self.plant.is_rigid() {
                self.ahead = (self.position - demand, -demand_velocity);
            }
        }
        self.counts = reached;
        // The loop goes on as without the wall, so that the shaft leaves it where the free one does.
        let free = self.position;
        let pressed = (!held).then(|| contact.press(free, demand, self.compliance()));
        let pressed = pressed.flatten();
        if let Some((position, _)) = pressed
            && step.seconds > 0.0
        {
            self.position = position;
            self.velocity = (position - old) / step.seconds;
            self.counts = position.round() as i64;
        }
        let torque = pressed.map_or_else(|| self.free_torque(), |(_, torque)| torque);
        self.torque = contact.limited(torque + contact.peak).round() as i16 as i64;
        self.measure(step);
    }

    /// The demand was placed where the shaft is, with its velocity.
    pub(super) fn caught(&mut self) {
        self.ahead = (0.0, 0.0);
        self.load = 0.0;
        self.demand = self.position;
        self.velocity_before = self.velocity;
        self.servo_velocity = self.velocity;
    }

    /// The shaft was put elsewhere, by hand.
    pub(super) fn place(&mut self, position: i64) {
        self.position = position as f64;
        self.velocity = 0.0;
        self.counts = position;
        self.encoder = position;
        self.estimate = 0.0;
        self.caught();
    }

    /// All positions are counted from elsewhere, `by` counts further down.
    pub(super) fn shift(&mut self, by: i64) {
        self.demand += by as f64;
        self.position += by as f64;
        self.counts = self.counts.saturating_add(by);
        self.encoder = self.encoder.saturating_add(by);
    }

    /// 606Ch in counts/s, before its factor.
    pub(super) fn shown_velocity(&self) -> f64 {
        let velocity = if self.plant.velocity_filter.is_zero() {
            self.velocity
        } else {
            self.estimate
        };
        let step = f64::from(self.plant.velocity_step);
        if step > 0.0 {
            (velocity / step).round() * step
        } else {
            velocity
        }
    }

    /// Whether the shaft is slow enough to count as standing.
    pub(super) fn is_slow(&self) -> bool {
        self.velocity.abs() <= f64::from(self.plant.standstill_velocity)
    }

    /// Whether the statusword is composed in this drive cycle.
    pub(super) fn composes_word(&mut self, period: Duration) -> bool {
        let cycle = nanoseconds(self.plant.word_cycle);
        if cycle == 0 {
            return true;
        }
        self.since_word = self.since_word.saturating_add(nanoseconds(period));
        let due = self.since_word >= cycle;
        self.since_word %= cycle;
        due
    }

    fn run_loop(&mut self, step: Step, demand_velocity: f64) {
        self.loads(step);
        let (ahead, gaining) = self.ahead;
        let change = demand_velocity - self.servo_velocity;
        let acceleration = if step.seconds > 0.0 {
            change / step.seconds
        } else {
            0.0
        };
        if acceleration == 0.0
            && demand_velocity == 0.0
            && self.load == 0.0
            && ahead.abs() < AT_REST.0
            && gaining.abs() < AT_REST.1
        {
            self.ahead = (0.0, 0.0);
            return;
        }
        let (omega, drag) = self.loop_constants();
        let mean = 0.5 * (demand_velocity + self.servo_velocity);
        let lag = drag * (1.0 - within(self.plant.feed_forward, 0.0, 1.0)) * mean;
        // Where the loop would come to rest.
        let rest = (self.load - acceleration - lag) / (omega * omega);
        let off = ahead - rest;
        self.ahead = (
            rest + step.of_position.0 * off + step.of_position.1 * gaining,
            step.of_velocity.0 * off + step.of_velocity.1 * gaining,
        );
    }

    /// Loads fade as the loop takes them up, and new ones come.
    fn loads(&mut self, step: Step) {
        self.load *= step.load;
        let (omega, _) = self.loop_constants();
        let whole = f64::from(self.plant.load_step) * omega * omega;
        if self.load.abs() < 1e-4 * whole {
            self.load = 0.0;
        }
        if whole == 0.0 || self.plant.load_every.is_zero() {
            return;
        }
        if self.until_load > step.nanoseconds {
            self.until_load -= step.nanoseconds;
            return;
        }
        self.until_load = self.time_to_load();
        self.load = whole * self.random.unit();
    }

    fn time_to_load(&mut self) -> u64 {
        let every = nanoseconds(self.plant.load_every);
        every / 2 + self.random.below(every.max(1))
    }

    /// What the drive measures of the shaft.
    fn measure(&mut self, step: Step) {
        let before = self.encoder;
        self.encoder = self.counts;
        if self.plant.dither > 0 {
            let width = 2 * u64::from(self.plant.dither) + 1;
            let dither = self.random.below(width) as i64 - i64::from(self.plant.dither);
            self.encoder = self.encoder.saturating_add(dither);
        }
        if !self.plant.velocity_filter.is_zero() && step.seconds > 0.0 {
            let difference = self.encoder.saturating_sub(before) as f64 / step.seconds;
            self.estimate += step.estimate * (difference - self.estimate);
        }
    }

    /// What the drive asks of its motor in free motion, in thousandths of the rated torque.
    fn free_torque(&self) -> f64 {
        if self.plant.rated_acceleration == 0 || self.plant.is_rigid() {
            return 0.0;
        }
        let (omega, drag) = self.loop_constants();
        // What the loop asks of the motor, apart from what it takes to change the velocity as demanded.
        let effort = -omega * omega * self.ahead.0 - drag * self.ahead.1;
        let friction = if self.velocity.abs() > AT_REST.1 {
            f64::from(self.plant.friction).copysign(self.velocity)
        } else {
            0.0
        };
        effort * 1_000.0 / f64::from(self.plant.rated_acceleration) + friction
    }

    /// Counts of following error at rest by each thousandth of the rated torque.
    fn compliance(&self) -> f64 {
        if self.plant.is_rigid() {
            return 0.0;
        }
        let (omega, _) = self.loop_constants();
        f64::from(self.plant.rated_acceleration) / (1_000.0 * omega * omega)
    }

    /// ω in 1/s, and 2ζω.
    fn loop_constants(&self) -> (f64, f64) {
        let omega = within(self.plant.bandwidth_hz, 0.1, 1_000.0) * TAU;
        (omega, 2.0 * within(self.plant.damping, 0.1, 5.0) * omega)
    }

    fn step(&mut self, elapsed: u64, cycle: u64) -> Step {
        let slot = elapsed.checked_div(cycle).unwrap_or(0) & 1;
        let known = self.steps.get(slot as usize).copied();
        if let Some(known) = known.filter(|step| step.nanoseconds == elapsed) {
            return known;
        }
        let seconds = elapsed as f64 * 1e-9;
        let fades = |time: Duration| {
            let time = time.as_secs_f64();
            if time > 0.0 {
                (-seconds / time).exp()
            } else {
                0.0
            }
        };
        let mut step = Step {
            nanoseconds: elapsed,
            seconds,
            load: fades(self.plant.load_recovery),
            estimate: 1.0 - fades(self.plant.velocity_filter),
            ..Step::default()
        };
        if !self.plant.is_rigid() {
            let (omega, drag) = self.loop_constants();
            (step.of_position, step.of_velocity) = transition(omega, drag * 0.5, seconds);
        }
        if let Some(slot) = self.steps.get_mut(slot as usize) {
            *slot = step;
        }
        step
    }
}

/// How position and velocity of x'' = −ω²x − 2δx' go on after a time, from a position and a velocity.
fn transition(omega: f64, delta: f64, time: f64) -> ((f64, f64), (f64, f64)) {
    let fade = (-delta * time).exp();
    let under_root = omega * omega - delta * delta;
    // cos(φt) and sin(φt)/φ, or their hyperbolic kin, which overflow nowhere: φ < δ.
    let (even, odd) = if under_root.abs() < 1e-6 * omega * omega {
        (fade, fade * time)
    } else if under_root > 0.0 {
        let phi = under_root.sqrt();
        (fade * (phi * time).cos(), fade * (phi * time).sin() / phi)
    } else {
        let phi = (-under_root).sqrt();
        let (slow, fast) = (((phi - delta) * time).exp(), (-(phi + delta) * time).exp());
        (0.5 * (slow + fast), 0.5 * (slow - fast) / phi)
    };
    (
        (even + delta * odd, odd),
        (-omega * omega * odd, even - delta * odd),
    )
}

/// A setting within its range; one that is no number is the least.
fn within(setting: f64, least: f64, most: f64) -> f64 {
    setting.max(least).min(most)
}

/// A servo cycle within its range, in nanoseconds; 0 where it goes with the drive's cycles.
fn servo_cycle(plant: &Plant) -> u64 {
    match nanoseconds(plant.cycle) {
        0 => 0,
        cycle => cycle.clamp(CYCLES.0, CYCLES.1),
    }
}

/// At most a year.
fn nanoseconds(time: Duration) -> u64 {
    const YEAR: u64 = 365 * 86_400 * 1_000_000_000;
    u64::try_from(time.as_nanos()).unwrap_or(YEAR).min(YEAR)
}

/// Numbers from a seed (splitmix64).
#[derive(Debug, Clone)]
struct Noise(u64);

impl Noise {
    fn new(seed: u64) -> Noise {
        Noise(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// From 0 to one less than `limit`; 0 for a limit of 0.
    fn below(&mut self, limit: u64) -> u64 {
        ((u128::from(self.next()) * u128::from(limit)) >> 64) as u64
    }

    /// From −1 to 1.
    fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}
