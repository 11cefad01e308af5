//! An axis whose positions begin again: the position range limits 607Bh, narrower than their type.
//!
//! DSP 402 has positions wrap at the limits. Which way round an absolute target is approached, bits 7 and 6 of 60F2h say;
//! inside, positions run on without an end.

use super::axis::Axis;
use super::objects;
use super::positioning::Direction;

impl Axis {
    /// The least position and the length of one turn, where 607Bh is set to one.
    fn turn(&self) -> Option<(i64, i64)> {
        let min = self.objects.value(objects::RANGE_MIN);
        let turn = self.objects.value(objects::RANGE_MAX) - min + 1;
        (1 < turn && turn < 1 << 32).then_some((min, turn))
    }

    /// A position, as the master counts it, as the objects show it.
    pub(super) fn in_range(&self, position: i64) -> i64 {
        match self.turn() {
            Some((min, turn)) => min + position.saturating_sub(min).rem_euclid(turn),
            None => position,
        }
    }

    /// Where an absolute target lies for an axis that comes from `from`.
    pub(super) fn unrolled(&self, target: i64, from: i64, direction: Direction) -> i64 {
        let Some((_, turn)) = self.turn() else {
            return target;
        };
        let way = self.in_range(target) - self.in_range(from);
        let ahead = way.rem_euclid(turn);
        from.saturating_add(match direction {
            Direction::Linear => way,
            Direction::Positive => ahead,
            Direction::Negative if ahead == 0 => 0,
            Direction::Shortest if ahead <= turn / 2 => ahead,
            Direction::Negative | Direction::Shortest => ahead - turn,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::Behaviour;
    use super::*;

    #[test]
    fn each_direction_option_goes_its_own_way_round() {
        let mut axis = Axis::new(Behaviour::generic());
        axis.set(0x607B, 1, 0).unwrap();
        axis.set(0x607B, 2, 3_599).unwrap();
        // From 350.0° in the fifth turn to 10.0°.
        let from = 4 * 3_600 + 3_500;
        for (option, way) in [(0, -3_400), (1, -3_400), (2, 200), (3, 200)] {
            axis.set(0x60F2, 0, option << 6).unwrap();
            let direction = axis.positioning().direction;
            let unrolled = |target| axis.unrolled(target, from, direction);
            assert_eq!(unrolled(100), from + way, "option {option}");
            assert_eq!(unrolled(3_500), from, "option {option}");
        }
        assert_eq!(axis.in_range(-1), 3_599);
        axis.set(0x607B, 2, 0).unwrap();
        let unrolled = axis.unrolled(100, from, Direction::Linear);
        assert_eq!(unrolled, 100, "an empty range is none");
        assert_eq!(axis.in_range(-1), -1);
    }
}
