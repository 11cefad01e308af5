//! Homing mode: the search for switch, edge and index pulse, the shift of the coordinates, and what bits 10, 12 and 13
//! of the statusword say meanwhile.
//!
//! | bits 13, 12, 10 | meaning (CiA 402) |
//! |---|---|
//! | 0 0 0 | in progress |
//! | 0 0 1 | interrupted, or not started |
//! | 0 1 0 | home position attained, the axis still moves |
//! | 0 1 1 | completed |
//! | 1 0 0 | homing error, the axis still moves |
//! | 1 0 1 | homing error, the axis stands |
//!
//! What no document says and is therefore assumed: an edge or pulse is latched exactly, the axis slows down behind it by
//! 609Ah and does not return; the last result is shown until the next start, also after a while in another mode.

use super::axis::Axis;
use super::behaviour::HomeOffset;
use super::homing_method::{Edge, Method};
use super::ledger::{Cause, Homing, HomingError, HomingOutcome};
use super::machine::{NEGATIVE_LIMIT, POSITIVE_LIMIT};
use super::objects;
use super::state::State;
use super::trajectory::{Bounds, Shape};

/// 6061h of homing mode.
pub(super) const HOMING: i64 = 6;

/// How the last homing ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Verdict {
    /// Not at all, or it was interrupted.
    #[default]
    None,
    Attained,
    Failed,
}

/// The mode's memory.
#[derive(Debug, Clone, Default)]
pub(super) struct HomingState {
    run: Option<Run>,
    verdict: Verdict,
    /// The verdict before this homing was [`Verdict::Attained`]: what an old statusword would show.
    was_attained: bool,
}

/// A homing under way.
#[derive(Debug, Clone, Copy)]
struct Run {
    /// Its line in the ledger.
    line: usize,
    method: Method,
    step: Step,
    /// The search has turned round at a limit switch.
    turned: bool,
    /// Counts/s, while a switch is looked for (6099h:1).
    fast: f64,
    /// Counts/s, while the home position is looked for (6099h:2).
    slow: f64,
    /// Counts/s² (609Ah).
    acceleration: f64,
    /// Machine position and switches in the cycle before.
    seen: (i64, u32),
}

/// What a homing does now; `up` is toward larger positions.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Step {
    /// Takes the position where the axis stands.
    Here,
    /// Looks for the switch, fast.
    Search { up: bool },
    /// Leaves the switch in order to meet its edge from outside, fast.
    Leave { up: bool },
    /// Crosses the home edge, slowly.
    Cross { up: bool },
    /// Goes on to an index pulse, slowly; without one it ends at a limit switch at best.
    Index { up: bool, at: Option<i64> },
}

impl Axis {
    /// Homing mode in this cycle. `rise`: bit 4 has risen.
    pub(super) fn run_homing(&mut self, controlword: u16, can_take: bool, rise: bool) {
        if self.objects.value(objects::MODE_DISPLAY) != HOMING {
            return;
        }
        if self.state == State::OperationEnabled && self.leaving_to.is_none() {
            self.progress();
        }
        if !can_take {
            return;
        }
        self.run_homing_halt(controlword & 0x0100 != 0);
        if controlword & 0x0010 == 0 && self.homing.run.is_some() {
            self.end_homing(HomingOutcome::Interrupted);
            self.begin_halt();
        }
        if rise {
            self.start_homing();
        }
    }

    /// Drops a homing under way.
    pub(super) fn discard_homing(&mut self, cause: Cause) {
        self.end_homing(HomingOutcome::Discarded(cause));
    }

    /// Whether the last homing has found its home position, and whether it has ended without.
    pub(crate) fn homing_verdict(&self) -> (bool, bool) {
        (
            self.homing.verdict == Verdict::Attained,
            self.homing.verdict == Verdict::Failed,
        )
    }

    /// A homing is under way, or paused by a halt.
    pub(crate) fn is_homing(&self) -> bool {
        self.homing.run.is_some()
    }

    /// No homing has ended yet, and the drive shows that as one in progress.
    pub(super) fn shows_progress_before_homing(&self) -> bool {
        self.disturbances.progress_before_homing && self.homing.verdict == Verdict::None
    }

    /// Bits 12 and 13; `stale`: what was shown before the start is still shown.
    pub(super) fn homing_bits(&self, stale: bool) -> (bool, bool) {
        let attained =
            self.homing.verdict == Verdict::Attained || (stale && self.homing.was_attained);
        (attained, self.homing.verdict == Verdict::Failed)
    }

    fn run_homing_halt(&mut self, halt: bool) {
        if halt && !self.buffer.halted {
            self.buffer.halted = true;
            if !self.behaviour.halt_keeps {
                self.end_homing(HomingOutcome::Discarded(Cause::Halt));
            }
            self.begin_halt();
        } else if !halt && self.buffer.halted {
            self.buffer.halted = false;
            self.drive_homing();
        }
    }

    fn start_homing(&mut self) {
        let number = self.objects.value(objects::HOMING_METHOD) as i8;
        let (fast, slow) = (
            self.objects.velocity(objects::HOMING_SPEED_SWITCH),
            self.objects.velocity(objects::HOMING_SPEED_ZERO),
        );
        let acceleration = self
            .objects
            .acceleration_within(objects::HOMING_ACCELERATION, objects::MAX_ACCELERATION);
        self.homings.push(Homing {
            method: number,
            started_at: self.now,
            start_position: self.trajectory.counts(),
            ended_at: None,
            home: None,
            offset: None,
            outcome: HomingOutcome::Active,
        });
        let line = self.homings.len() - 1;
        self.reached
            .set_point_taken(self.disturbances.stale_reached_cycles);
        self.homing.was_attained = self.homing.verdict == Verdict::Attained;
        self.homing.verdict = Verdict::None;
        self.referenced = self.behaviour.machine.absolute_encoder;

        let known = self.behaviour.homing_methods.contains(&number);
        let method = Method::of(number).filter(|_| known);
        let seen = (self.mechanical_position(), self.switches());
        let mut run = Run {
            line,
            method: Method::Here,
            step: Step::Here,
            turned: false,
            fast,
            slow,
            acceleration,
            seen,
        };
        let error = match method {
            None => Some(HomingError::Method),
            Some(Method::Here) => None,
            Some(Method::Index { .. }) if slow * acceleration > 0.0 => None,
            Some(Method::Edge(_)) if fast * slow * acceleration > 0.0 => None,
            Some(_) => Some(HomingError::SpeedZero),
        };
        if let Some(method) = method {
            run.method = method;
            run.step = first_step(method, seen, |from, up| {
                self.behaviour.machine.index_from(from, up)
            });
        }
        self.homing.run = Some(run);
        if let Some(error) = error {
            self.fail_homing(error);
        } else if !self.buffer.halted {
            self.drive_homing();
        }
    }

    /// Runs the axis as the present step needs it.
    fn drive_homing(&mut self) {
        let Some(run) = self.homing.run else { return };
        let (up, speed) = match run.step {
            Step::Here => return,
            Step::Search { up } | Step::Leave { up } => (up, run.fast),
            Step::Cross { up } | Step::Index { up, .. } => (up, run.slow),
        };
        let velocity = if up { speed } else { -speed };
        let bounds = Bounds {
            velocity: speed,
            end_velocity: speed,
            acceleration: run.acceleration,
            deceleration: run.acceleration,
            shape: Shape::Linear,
        };
        self.trajectory.run_at(velocity, bounds);
    }

    /// Looks at what the last cycle's motion has met.
    fn progress(&mut self) {
        let Some(mut run) = self.homing.run else {
            return;
        };
        let (before, old) = run.seen;
        let (now, switches) = (self.mechanical_position(), self.switches());
        run.seen = (now, switches);
        let moved = |up: bool| if up { now > before } else { now < before };
        let at_limit = |up: bool| switches & if up { POSITIVE_LIMIT } else { NEGATIVE_LIMIT } != 0;
        let edge = match run.method {
            Method::Edge(edge) => edge,
            Method::Here | Method::Index { .. } => Edge::default(),
        };
        let (was, is) = (old & edge.switch != 0, switches & edge.switch != 0);
        self.homing.run = Some(run);
        match run.step {
            Step::Here => self.attain(now),
            Step::Search { .. } if is => self.take_step(found(edge)),
            Step::Search { up } if at_limit(up) => {
                if !edge.turns {
                    self.fail_homing(HomingError::LimitSwitch);
                } else if run.turned {
                    self.fail_homing(HomingError::NoHomeSwitch);
                } else {
                    run.turned = true;
                    self.homing.run = Some(run);
                    self.take_step(Step::Search { up: !up });
                }
            }
            Step::Leave { up } if was && !is && moved(up) => {
                self.take_step(Step::Cross { up: edge.up });
            }
            Step::Cross { up } if was != is && is == edge.to_active && moved(up) => {
                let exact = self.behaviour.machine.edge(edge.switch, up, is);
                let passed = |at: &i64| (before.min(now)..=before.max(now)).contains(at);
                // A switch that a test operates by hand has no place on the machine.
                let home = exact.filter(passed).unwrap_or(now);
                if edge.index {
                    let at = self.behaviour.machine.index_from(home, up);
                    self.take_step(Step::Index { up, at });
                } else {
                    self.attain(home);
                }
            }
            Step::Index { up, at: Some(at) } if if up { now >= at } else { now <= at } => {
                self.attain(at);
            }
            Step::Leave { up } | Step::Cross { up } | Step::Index { up, .. } if at_limit(up) => {
                self.fail_homing(HomingError::LimitSwitch);
            }
            _ => {}
        }
    }

    fn take_step(&mut self, step: Step) {
        if let Some(run) = &mut self.homing.run {
            run.step = step;
        }
        if !self.buffer.halted {
            self.drive_homing();
        }
    }

    /// The home position, in counts of the machine, was found: the coordinates shift, the axis slows down.
    fn attain(&mut self, home: i64) {
        let offset = self.objects.value(objects::HOME_OFFSET);
        let reads = match self.behaviour.home_offset {
            HomeOffset::HomeReadsOffset => offset,
            HomeOffset::ZeroBeyondHome => -offset,
        };
        self.shift_coordinates(home.saturating_sub(self.turned(reads)));
        self.stop_homing();
        let line = self.homing.run.map(|run| run.line);
        self.end_homing(HomingOutcome::Attained);
        if let Some(line) = line.and_then(|line| self.homings.get_mut(line)) {
            line.home = Some(home);
            line.offset = Some(offset as i32);
        }
        self.homing.verdict = Verdict::Attained;
        self.referenced = true;
    }

    fn fail_homing(&mut self, error: HomingError) {
        self.stop_homing();
        self.end_homing(HomingOutcome::Failed(error));
        self.homing.verdict = Verdict::Failed;
    }

    fn stop_homing(&mut self) {
        if let Some(run) = self.homing.run.filter(|_| !self.buffer.halted) {
            self.trajectory.stop(run.acceleration, Shape::Linear);
        }
    }

    fn end_homing(&mut self, outcome: HomingOutcome) {
        let Some(run) = self.homing.run.take() else {
            return;
        };
        let now = self.now;
        if let Some(line) = self.homings.get_mut(run.line) {
            line.ended_at = Some(now);
            line.outcome = outcome;
        }
    }
}

/// Where a method begins.
fn first_step(
    method: Method,
    (position, switches): (i64, u32),
    index_from: impl Fn(i64, bool) -> Option<i64>,
) -> Step {
    match method {
        Method::Here => Step::Here,
        Method::Index { up } => {
            let next = if up { 1 } else { -1 };
            let at = index_from(position.saturating_add(next), up);
            Step::Index { up, at }
        }
        Method::Edge(edge) if switches & edge.switch != 0 => found(edge),
        Method::Edge(edge) => Step::Search { up: edge.search_up },
    }
}

/// What follows when the switch is active: the edge where it becomes inactive lies ahead; for the one where it becomes
/// active it must be left first.
fn found(edge: Edge) -> Step {
    if edge.to_active {
        Step::Leave { up: !edge.up }
    } else {
        Step::Cross { up: edge.up }
    }
}
