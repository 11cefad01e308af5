//! A core that lets go of what makes no difference does what one does that keeps everything.

use servocrab::ds402::Controlword;

use crate::{
    descriptions,
    world::{ACTS, EVERY_KIND, Size, World},
};

#[test]
fn what_is_forgotten_makes_no_difference() {
    let size = Size {
        commands: 2,
        deviations: 2,
        kinds: EVERY_KIND,
    };
    let (mut state, mut acts) = (0x9E37_79B9_7F4A_7C15_u64, Vec::new());
    let mut random = move |below: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 33) as usize % below
    };
    let mut events = 0;
    for description in descriptions().repeat(40) {
        let mut one = World::new(description, size);
        one.told = Some(Vec::new());
        let mut other = one.clone();
        other.forgets = false;
        let mut way = Vec::new();
        for _ in 0..400 {
            one.acts(&mut acts);
            // Mostly nothing, so that times go by.
            let act = match random(5) {
                0 => acts[random(acts.len())],
                1 => acts[random(acts.len().min(14))],
                _ => 0,
            };
            let prompt = random(4) != 0;
            way.push((ACTS[usize::from(act)], prompt));
            let results = (one.step(act, prompt), other.step(act, prompt));
            assert_eq!(results.0, results.1, "{description:?}: {way:?}");
            assert_eq!(one.told, other.told, "{description:?}: {way:?}");
            assert_eq!(one.around, other.around, "{description:?}: {way:?}");
            let (a, b) = (one.core.snapshot(), other.core.snapshot());
            assert_eq!(a, b, "{description:?}: {way:?}");
            if a.controlword.contains(Controlword::NEW_SET_POINT) {
                assert_eq!(one.outputs, other.outputs, "{description:?}: {way:?}");
            }
            if results.0.is_err() {
                break;
            }
            for world in [&mut one, &mut other] {
                if let Some(told) = &mut world.told {
                    events += told.len();
                    told.clear();
                }
            }
        }
    }
    assert!(events > 10_000, "{events}");
}
