//! Where a set-point may end (pure).

use super::Bounds;

/// The positions at which a set-point may end: a distance counts from what the drive takes for its base, and that may not be known to
/// the count.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct Ends {
    from: i32,
    /// To the last one, in counts; [`ANYWHERE`](Self::ANYWHERE) has them all.
    width: u32,
}

/// The positions from the first to the second, both included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Quiet(i32, i32);

impl Quiet {
    pub const EVERYWHERE: Self = Self(i32::MIN, i32::MAX);
    pub const NOWHERE: Self = Self(i32::MAX, i32::MIN);

    #[inline]
    pub const fn contains(self, position: i32) -> bool {
        self.0 <= position && position <= self.1
    }
}

impl Default for Quiet {
    fn default() -> Self {
        Self::NOWHERE
    }
}

impl Ends {
    pub const ANYWHERE: Self = Self {
        from: 0,
        width: u32::MAX,
    };

    pub const fn at(position: i32) -> Self {
        Self {
            from: position,
            width: 0,
        }
    }

    /// These, and all between them and the others.
    pub fn with(self, other: Self, bounds: &Bounds) -> Self {
        if self == Self::ANYWHERE || other == Self::ANYWHERE {
            return Self::ANYWHERE;
        }
        let last = |ends: Self| bounds.way(self.from, ends.from) + i64::from(ends.width);
        let first = bounds.way(self.from, other.from).min(0);
        let width = last(self).max(last(other)) - first;
        Self {
            from: bounds.after(self.from, first as i32),
            width: u32::try_from(width).unwrap_or(u32::MAX),
        }
    }

    /// The same, this far away.
    pub fn after(self, distance: i32, bounds: &Bounds) -> Self {
        if self == Self::ANYWHERE {
            return self;
        }
        Self {
            from: bounds.after(self.from, distance),
            ..self
        }
    }

    /// Whether they are known to the window.
    #[inline]
    pub const fn are_known(&self, bounds: &Bounds) -> bool {
        self.width <= bounds.position
    }

    /// The one that an error names: the middle.
    pub fn middle(&self, bounds: &Bounds) -> i32 {
        let half = i32::try_from(self.width / 2).unwrap_or(0);
        bounds.after(self.from, half)
    }

    /// The middle where they are known; else the first and the last.
    pub fn outermost(&self, bounds: &Bounds) -> [i32; 2] {
        if self.are_known(bounds) {
            return [self.middle(bounds); 2];
        }
        let half = i32::try_from(self.width / 2).unwrap_or(i32::MAX);
        let rest = i32::try_from(self.width.div_ceil(2)).unwrap_or(i32::MAX);
        let last = bounds.after(bounds.after(self.from, half), rest);
        [self.from, last]
    }

    /// Whether an axis at this position is within the window of the end: of all of them, where they are known, else of one.
    #[inline]
    pub fn contain(&self, position: i32, bounds: &Bounds) -> bool {
        if !self.are_known(bounds) {
            return self.may_contain(position, bounds);
        }
        let window = i64::from(bounds.position);
        let way = bounds.way(self.from, position);
        way <= window && way >= i64::from(self.width) - window
    }

    /// Whether an axis at this position is within the window of one of them.
    #[inline]
    pub fn may_contain(&self, position: i32, bounds: &Bounds) -> bool {
        self.width == u32::MAX || self.outside(position, bounds) == 0
    }

    /// Whether an axis that was seen at these two positions, one after the other, was within the window of one of them, or has passed
    /// them all in between.
    pub fn are_met(&self, before: i32, position: i32, bounds: &Bounds) -> bool {
        if self.contain(position, bounds) {
            return true;
        }
        let (from, to) = (self.outside(before, bounds), self.outside(position, bounds));
        // On a circle the far side has another sign as well.
        let reach = i64::from(self.width) + 2 * i64::from(bounds.position);
        let way = bounds.way(before, position).abs();
        from.signum() * to.signum() < 0 && from.abs() + to.abs() + reach == way
    }

    /// The positions on this side of them, which an axis there leaves when it meets them.
    pub fn away_from(&self, position: i32, bounds: &Bounds) -> Quiet {
        let window = i64::from(bounds.position);
        let low = i64::from(self.from) - window;
        let high = i64::from(self.from) + i64::from(self.width) + window;
        let fits = |end: i64| i32::try_from(end).ok();
        match (fits(low), fits(high)) {
            (Some(low), Some(high)) if bounds.turn.is_none() => {
                if position < low {
                    Quiet(i32::MIN, low - 1)
                } else if position > high {
                    Quiet(high + 1, i32::MAX)
                } else {
                    Quiet::NOWHERE
                }
            }
            _ => Quiet::NOWHERE,
        }
    }

    /// How far a position lies from them, beyond the window: negative before the first, positive behind the last.
    #[inline]
    fn outside(&self, position: i32, bounds: &Bounds) -> i64 {
        let window = i64::from(bounds.position);
        let way = bounds.way(self.from, position);
        let beyond = way - i64::from(self.width);
        if way < -window {
            way + window
        } else if beyond > window {
            beyond - window
        } else {
            0
        }
    }

    /// Whether an axis has covered half of the way from these ends to the next ones. None where either is not known, or they lie no more
    /// than four windows apart (A2).
    pub fn half_way_to(&self, next: &Self, position: i32, bounds: &Bounds) -> Option<bool> {
        if !(self.are_known(bounds) && next.are_known(bounds)) {
            return None;
        }
        let (begin, end) = (self.middle(bounds), next.middle(bounds));
        let way = bounds.way(begin, end);
        if way.unsigned_abs() <= 4 * u64::from(bounds.position) {
            return None;
        }
        let come = bounds.way(begin, position) * way.signum();
        Some(2 * come >= way.abs())
    }
}
