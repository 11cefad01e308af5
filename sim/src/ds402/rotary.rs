//! An axis whose positions begin again: the position range limits 607Bh, narrower than their type.
//!
//! DSP 402 has positions wrap at the limits. Which way round an absolute target is approached, bits 7 and 6 of 60F2h say;
//! inside, positions run on without an end.

use super::axis::Axis;
use super::objects;

impl Axis {
    /// The least position and the length of one turn, where 607Bh is set to one.
    fn turn(&self) -> Option<(i64, i64)> {
        let min = self.objects.value(objects::RANGE_MIN);
        let turn = self.objects.value(objects::RANGE_MAX) - min + 1;
        (1 < turn && turn < 1 << 32).then_some((min, turn))
    }

    /// A position as the objects show it.
    pub(super) fn in_range(&self, position: i64) -> i64 {
        match self.turn() {
            Some((min, turn)) => min + (position - min).rem_euclid(turn),
            None => position,
        }
    }

    /// Where an absolute target lies for an axis that comes from `from`.
    pub(super) fn unrolled(&self, target: i64, from: i64) -> i64 {
        let Some((_, turn)) = self.turn() else {
            return target;
        };
        let (here, there) = (self.in_range(from), self.in_range(target));
        let ahead = (there - here).rem_euclid(turn);
        from + match self.objects.value(objects::POSITIONING_OPTION) >> 6 & 3 {
            // Like a linear axis, not across the ends of the range.
            0 => there - here,
            // In negative direction only.
            1 if ahead == 0 => 0,
            1 => ahead - turn,
            // In positive direction only.
            2 => ahead,
            // The shortest way.
            _ if ahead > turn / 2 => ahead - turn,
            _ => ahead,
        }
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
            assert_eq!(axis.unrolled(100, from), from + way, "option {option}");
            assert_eq!(axis.unrolled(3_500, from), from, "option {option}");
        }
        assert_eq!(axis.in_range(-1), 3_599);
        axis.set(0x607B, 2, 0).unwrap();
        assert_eq!(axis.unrolled(100, from), 100, "an empty range is none");
        assert_eq!(axis.in_range(-1), -1);
    }
}
