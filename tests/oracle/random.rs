//! Numbers from one seed.

/// SplitMix64.
#[derive(Debug, Clone, Default)]
pub struct Random(u64);

impl Random {
    pub const fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub const fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// A stream of its own, so that what one part of a scenario draws changes nothing for the others.
    pub const fn fork(&mut self) -> Self {
        Self(self.next())
    }

    /// 0 to n − 1.
    pub const fn below(&mut self, n: u64) -> u64 {
        ((self.next() >> 32) * n) >> 32
    }

    pub const fn one_in(&mut self, n: u64) -> bool {
        self.below(n) == 0
    }

    pub fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.below(of.len() as u64) as usize]
    }

    /// From `from` up to and with `to`.
    pub const fn between(&mut self, from: i32, to: i32) -> i32 {
        from + self.below((to - from) as u64 + 1) as i32
    }
}
