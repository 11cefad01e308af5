//! A trajectory with separate acceleration and deceleration, as a short list of ramps and a cruise between them. It ends
//! exactly on its target.

use super::ramp::Segment;
pub(super) use super::ramp::{Bounds, Shape};

/// Seconds that a sum of cycle times may fall short of a segment's end; no cycle is added for them.
const ROUNDING: f64 = 1e-9;

/// What the generator is doing.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Course {
    /// Keeps its position.
    Hold,
    /// Slows down to zero, wherever that is.
    Stop,
    /// Runs to a position, in counts.
    To(f64),
    /// Gets to a velocity and keeps it.
    At,
}

/// The demand of the position loop: position in counts, velocity in counts/s, and what is planned.
#[derive(Debug, Clone)]
pub(super) struct Trajectory {
    position: f64,
    velocity: f64,
    course: Course,
    /// Of the ramps that are planned next.
    shape: Shape,
    /// Counts/s at which ramps from and to standstill start and end.
    floor: f64,
    /// The axis stands when all that was planned is done, also where the last ramp ended at the floor.
    ends_standing: bool,
    /// At most four are ever needed: brake, accelerate, cruise, decelerate.
    segments: [Segment; 4],
    count: usize,
    current: usize,
    elapsed: f64,
    segment_start: f64,
}

impl Trajectory {
    pub(super) fn at(position: i64) -> Trajectory {
        Trajectory {
            position: position as f64,
            velocity: 0.0,
            course: Course::Hold,
            shape: Shape::Linear,
            floor: 0.0,
            ends_standing: true,
            segments: [Segment::default(); 4],
            count: 0,
            current: 0,
            elapsed: 0.0,
            segment_start: position as f64,
        }
    }

    /// From the next plan on, ramps from and to standstill start and end at this speed, in counts/s.
    pub(super) fn set_floor(&mut self, floor: f64) {
        self.floor = floor;
    }

    /// Counts, with the fraction.
    pub(super) fn position(&self) -> f64 {
        self.position
    }

    /// Counts/s.
    pub(super) fn velocity(&self) -> f64 {
        self.velocity
    }

    /// The nearest whole count.
    pub(super) fn counts(&self) -> i64 {
        self.position.round() as i64
    }

    pub(super) fn stands(&self) -> bool {
        self.velocity == 0.0 && self.current >= self.count
    }

    /// Whether all that was planned is done. A trajectory to a target that its bounds do not allow is never done.
    pub(super) fn is_done(&self) -> bool {
        self.current >= self.count
            && match self.course {
                Course::To(target) => self.position == target,
                Course::Hold | Course::Stop | Course::At => true,
            }
    }

    /// Plans from the present position and velocity to `target`.
    ///
    /// With a velocity or acceleration of zero there is no motion: an axis that stands stays, one that moves stops.
    pub(super) fn run_to(&mut self, target: i64, bounds: Bounds) {
        self.begin(Course::To(target as f64), bounds.shape);
        let steepest = bounds.deceleration;
        let bounds = Bounds {
            acceleration: bounds.shape.mean(bounds.acceleration),
            deceleration: bounds.shape.mean(bounds.deceleration),
            ..bounds
        };
        if !bounds.can_move() {
            self.brake(bounds.deceleration);
            return;
        }
        let end_velocity = bounds.end_velocity.clamp(0.0, bounds.velocity);
        let mut distance = target as f64 - self.position;
        let mut start = self.velocity;
        let toward = start * distance > 0.0;
        // A relative 1e-12 lets a stop that was planned to end on this very target pass in spite of rounding.
        let room = 2.0 * distance.abs() * (1.0 + 1e-12);
        let to_lose = start * start - end_velocity * end_velocity;
        let brakes_in_time = to_lose <= bounds.deceleration * room;
        if toward && !brakes_in_time && to_lose <= steepest * room {
            // Planned anew in the steep middle of a sin² ramp: another one from here would end behind the target.
            self.shape = Shape::Linear;
            let end = distance.signum() * end_velocity;
            self.ends_standing = end == 0.0;
            self.push(start, end, to_lose / (2.0 * distance.abs()));
            return;
        }
        if start != 0.0 && !(toward && brakes_in_time) {
            distance -= self.brake(bounds.deceleration);
            start = 0.0;
        }
        self.ends_standing = end_velocity == 0.0;
        if distance != 0.0 {
            let floor = self.floor.min(bounds.velocity);
            self.plan_toward(
                distance,
                start.abs().max(floor),
                end_velocity.max(floor),
                bounds,
            );
        }
        if self.count == 0 {
            self.arrive();
        }
    }

    /// Plans the ramp down to standstill and tells its way.
    fn brake(&mut self, rate: f64) -> f64 {
        let start = self.velocity;
        let end = start.signum() * self.floor.min(start.abs());
        self.ends_standing = true;
        self.push(start, end, rate);
        if self.count == 0 {
            self.velocity = 0.0;
            return 0.0;
        }
        (start * start - end * end) * start.signum() / (2.0 * rate)
    }

    /// Plans to get to a velocity in counts/s and to keep it. Without acceleration an axis stays or stops.
    pub(super) fn run_at(&mut self, velocity: f64, bounds: Bounds) {
        let shape = bounds.shape;
        if bounds.acceleration <= 0.0 || velocity == 0.0 {
            self.stop(bounds.deceleration, shape);
            return;
        }
        self.begin(Course::At, shape);
        let acceleration = shape.mean(bounds.acceleration);
        let deceleration = shape.mean(bounds.deceleration);
        let from = self.velocity;
        let floor = velocity.signum() * self.floor.min(velocity.abs());
        if from * velocity < 0.0 {
            self.brake(deceleration);
            self.push(floor, velocity, acceleration);
        } else if from.abs() > velocity.abs() {
            self.push(from, velocity, deceleration);
        } else if from.abs() < floor.abs() {
            self.push(floor, velocity, acceleration);
        } else {
            self.push(from, velocity, acceleration);
        }
        self.add(Segment {
            from: velocity,
            to: velocity,
            time: f64::INFINITY,
            shape: Shape::Linear,
        });
    }

    /// Counts all positions from elsewhere, `by` counts further down. Nothing moves.
    pub(super) fn shift(&mut self, by: i64) {
        let by = by as f64;
        self.position += by;
        self.segment_start += by;
        if let Course::To(target) = &mut self.course {
            *target += by;
        }
    }

    /// Plans a stop with the given deceleration in counts/s²; a deceleration of zero stops at once.
    pub(super) fn stop(&mut self, deceleration: f64, shape: Shape) {
        let rate = shape.mean(deceleration);
        let present = self.segments.get(self.current);
        let stops_so = |segment: &&Segment| {
            segment.to == 0.0
                && segment.shape == shape
                && (segment.from.abs() - rate * segment.time).abs() <= 1e-9 * segment.from.abs()
        };
        if self.current < self.count && present.filter(stops_so).is_some() {
            // A sin² ramp begun anew would end further away.
            self.course = Course::Stop;
            self.ends_standing = true;
            self.count = self.current + 1;
            return;
        }
        self.begin(Course::Stop, shape);
        self.brake(rate);
    }

    /// Puts the axis elsewhere, standing, with nothing planned.
    pub(super) fn place(&mut self, position: i64) {
        *self = Trajectory::at(position);
    }

    /// Puts the axis elsewhere with a velocity and nothing planned.
    pub(super) fn catch(&mut self, position: f64, velocity: f64) {
        let floor = self.floor;
        *self = Trajectory::at(0);
        self.floor = floor;
        self.position = position;
        self.segment_start = position;
        self.velocity = velocity;
    }

    /// Moves on by `dt` seconds and returns what is left of it when the plan ended before.
    pub(super) fn advance(&mut self, mut dt: f64) -> f64 {
        while let Some(segment) = self
            .segments
            .get(self.current)
            .copied()
            .filter(|_| self.current < self.count)
        {
            let left = segment.time - self.elapsed;
            if dt + ROUNDING < left {
                self.elapsed += dt;
                let (way, velocity) = segment.after(self.elapsed);
                self.velocity = velocity;
                self.position = self.segment_start + way;
                return 0.0;
            }
            dt = (dt - left).max(0.0);
            self.velocity = segment.to;
            self.segment_start += (segment.from + segment.to) * 0.5 * segment.time;
            self.position = self.segment_start;
            self.elapsed = 0.0;
            self.current += 1;
            if self.current >= self.count {
                self.arrive();
            }
        }
        dt
    }

    /// The segments of a motion that starts toward the target and can end there; both velocities are speeds.
    fn plan_toward(&mut self, distance: f64, start: f64, end: f64, bounds: Bounds) {
        let direction = distance.signum();
        let way = distance.abs();
        let Bounds {
            velocity: top,
            acceleration: up,
            deceleration: down,
            ..
        } = bounds;
        if start > top {
            self.push(direction * start, direction * top, down);
            let slowing = (start * start - end * end) / (2.0 * down);
            self.cruise(direction * top, way - slowing);
            self.push(direction * top, direction * end, down);
            return;
        }
        let peak_squared =
            (2.0 * up * down * way + down * start * start + up * end * end) / (up + down);
        let peak = peak_squared.max(start * start).sqrt();
        if peak < end {
            // Too short to get up to the end velocity: faster until the target.
            let reached = (start * start + 2.0 * up * way).sqrt();
            self.push(direction * start, direction * reached, up);
            return;
        }
        let peak = peak.min(top);
        self.push(direction * start, direction * peak, up);
        let ramps =
            (peak * peak - start * start) / (2.0 * up) + (peak * peak - end * end) / (2.0 * down);
        self.cruise(direction * peak, way - ramps);
        self.push(direction * peak, direction * end, down);
    }

    fn begin(&mut self, course: Course, shape: Shape) {
        self.course = course;
        self.shape = shape;
        self.count = 0;
        self.current = 0;
        self.elapsed = 0.0;
        self.segment_start = self.position;
    }

    fn push(&mut self, from: f64, to: f64, rate: f64) {
        if from == to {
            return;
        }
        if rate > 0.0 {
            self.add(Segment {
                from,
                to,
                time: (to - from).abs() / rate,
                shape: self.shape,
            });
        } else {
            self.velocity = to;
        }
    }

    fn cruise(&mut self, velocity: f64, way: f64) {
        if way > 0.0 && velocity != 0.0 {
            self.add(Segment {
                from: velocity,
                to: velocity,
                time: way / velocity.abs(),
                shape: Shape::Linear,
            });
        }
    }

    fn add(&mut self, segment: Segment) {
        if let Some(slot) = self.segments.get_mut(self.count) {
            *slot = segment;
            self.count += 1;
        }
    }

    /// The plan is at its end: what rounding left between the last segment and the target is taken away.
    fn arrive(&mut self) {
        if self.ends_standing {
            self.velocity = 0.0;
        }
        if let Course::To(target) = self.course {
            // A plan that its bounds forbid stops where it stops.
            if (self.position - target).abs() < 0.5 {
                self.position = target;
            }
        }
    }
}
