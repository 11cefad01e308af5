//! Two states that are equal do the same from then on: what is no part of a core's hash makes no difference.

use std::collections::HashMap;

use crate::{
    descriptions,
    world::{EVERY_KIND, Size, World},
};

/// From xorshift, so that each run is the same.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 33) as usize % bound
    }

    /// An act, mostly none so that times go by, and whether the drive is prompt.
    fn act(&mut self, acts: &[u8]) -> (u8, bool) {
        let act = match self.below(5) {
            0 => acts[self.below(acts.len())],
            1 => acts[self.below(acts.len().min(14))],
            _ => 0,
        };
        (act, self.below(4) != 0)
    }
}

#[test]
fn states_that_are_equal_stay_equal() {
    let size = Size {
        commands: 2,
        deviations: 2,
        kinds: EVERY_KIND,
    };
    let (mut random, mut acts) = (Random(0x9E37_79B9_7F4A_7C15), Vec::new());
    let (mut met_again, mut told) = (0, 0);
    for description in descriptions() {
        let mut met: HashMap<u64, World> = HashMap::new();
        for _ in 0..12 {
            let mut world = World::new(description, size);
            for _ in 0..200 {
                world.acts(&mut acts);
                let (act, prompt) = random.act(&acts);
                if world.step(act, prompt).is_err() {
                    break;
                }
                let print = world.exact_print();
                let Some(other) = met.insert(print, world.clone()) else {
                    continue;
                };
                met_again += 1;
                let mut pair = [world.clone(), other];
                for _ in 0..12 {
                    pair[0].acts(&mut acts);
                    let (act, prompt) = random.act(&acts);
                    let [one, other] = pair.each_mut().map(|world| {
                        world.told = Some(Vec::new());
                        let done = world.step(act, prompt);
                        (done, world.told.take(), world.exact_print())
                    });
                    assert_eq!(one, other, "{description:?}: {}{}", pair[0], pair[1]);
                    told += one.1.map_or(0, |told| told.len());
                    if one.0.is_err() {
                        break;
                    }
                }
            }
        }
    }
    assert!(met_again > 5_000 && told > 5_000, "{met_again}, {told}");
}
