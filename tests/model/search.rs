//! Breadth first, until no state is new; then whether each leads to the end.

use core::fmt;
use std::collections::HashMap;
use std::sync::Mutex;
use std::time::Instant;

use crate::fingerprint::Fingerprint;
use crate::world::{Act, Description, LONGEST, Size, World};

pub struct Bounds {
    pub seconds: u64,
    pub threads: usize,
}

pub struct Found {
    pub states: usize,
    pub steps: u64,
    pub depth: u32,
    pub seconds: f64,
    /// States whose next ones were not looked at.
    pub left: usize,
    /// The longest way from a state to a disabled axis.
    pub longest_way: u32,
    pub violation: Option<(String, Vec<(Act, bool)>)>,
}

/// How a state was come to, and where the way to the end leads from it.
#[derive(Clone, Copy)]
struct State {
    before: u32,
    act: Act,
    prompt: bool,
    way: Way,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Way {
    Unknown,
    AtTheEnd,
    On(u32),
}

#[derive(Default)]
struct Seen {
    numbers: HashMap<u128, u32>,
    states: Vec<State>,
}

impl Seen {
    /// The number of a state, and whether it is new.
    fn number(&mut self, print: u128, before: u32, act: Act, prompt: bool) -> (u32, bool) {
        let next = self.states.len() as u32;
        let number = *self.numbers.entry(print).or_insert(next);
        if number == next {
            self.states.push(State {
                before,
                act,
                prompt,
                way: Way::Unknown,
            });
        }
        (number, number == next)
    }

    fn way_to(&self, mut number: u32) -> Vec<(Act, bool)> {
        let mut way = Vec::new();
        while let Some(state) = self
            .states
            .get(number as usize)
            .filter(|state| state.before != u32::MAX)
        {
            way.push((state.act, state.prompt));
            number = state.before;
        }
        way.reverse();
        way
    }
}

type Broken = Option<(String, Vec<(Act, bool)>)>;

pub fn search(description: Description, size: Size, bounds: &Bounds) -> Found {
    let begin = Instant::now();
    let is_late = || begin.elapsed().as_secs() >= bounds.seconds;
    let seen = Mutex::new(Seen::default());
    let first = World::new(description, size);
    let print = Fingerprint::default().of(&first.core, first.now, LONGEST, &first.around);
    let root = seen
        .lock()
        .expect("no panic")
        .number(print, u32::MAX, Act::Nothing, true)
        .0;
    let mut level = vec![(first, root)];
    let mut found = Found {
        states: 1,
        steps: 0,
        depth: 0,
        seconds: 0.0,
        left: 0,
        longest_way: 0,
        violation: None,
    };
    while !level.is_empty() && found.violation.is_none() && !is_late() {
        let (came, stopped, count) = (
            Mutex::new(Vec::new()),
            Mutex::new(Broken::None),
            Mutex::new((0_u64, 0_usize)),
        );
        let part = level.len().div_ceil(bounds.threads.max(1));
        std::thread::scope(|scope| {
            for worlds in level.chunks(part) {
                let (seen, came, stopped, count, is_late) =
                    (&seen, &came, &stopped, &count, &is_late);
                scope.spawn(move || {
                    let (mut steps, mut looked_at) = (0, 0);
                    let mut mine = Vec::new();
                    for (world, number) in worlds {
                        if is_late() {
                            break;
                        }
                        match expand(world, *number, seen, &mut mine) {
                            Ok(more) => steps += more,
                            Err(broken) => {
                                stopped.lock().expect("no panic").get_or_insert(broken);
                                break;
                            }
                        }
                        looked_at += 1;
                    }
                    let mut count = count.lock().expect("no panic");
                    count.0 += steps;
                    count.1 += looked_at;
                    came.lock().expect("no panic").append(&mut mine);
                });
            }
        });
        let (steps, looked_at) = count.into_inner().expect("no panic");
        found.steps += steps;
        found.left = level.len() - looked_at;
        found.depth += 1;
        found.violation = stopped.into_inner().expect("no panic");
        level = came.into_inner().expect("no panic");
    }
    found.left += level.len();
    let seen = seen.into_inner().expect("no panic");
    found.states = seen.states.len();
    if found.violation.is_none() {
        match ways(&seen) {
            Ok(longest) => found.longest_way = longest,
            Err(number) => {
                found.violation = Some((
                    "a sound drive does not lead from here to a disabled axis".into(),
                    seen.way_to(number),
                ));
            }
        }
    }
    found.seconds = begin.elapsed().as_secs_f64();
    found
}

/// Everything that may happen next.
fn expand(
    world: &World,
    number: u32,
    seen: &Mutex<Seen>,
    came: &mut Vec<(World, u32)>,
) -> Result<u64, (String, Vec<(Act, bool)>)> {
    let (mut acts, mut print) = (Vec::new(), Fingerprint::default());
    world.acts(&mut acts);
    let end = world.way_to_the_end();
    let mut way = if world.is_at_the_end() {
        Way::AtTheEnd
    } else {
        Way::Unknown
    };
    if !acts.contains(&end) {
        acts.push(end);
    }
    for &act in &acts {
        for prompt in [true, false] {
            let mut after = world.clone();
            let result = after.step(act, prompt);
            let state = print.of(&after.core, after.now, LONGEST, &after.around);
            let mut seen = seen.lock().expect("no panic");
            if let Err(what) = result {
                let mut way = seen.way_to(number);
                way.push((act, prompt));
                return Err((what, way));
            }
            let (next, new) = seen.number(state, number, act, prompt);
            if act == end && prompt && way == Way::Unknown {
                way = Way::On(next);
            }
            drop(seen);
            if new {
                came.push((after, next));
            }
        }
    }
    seen.lock().expect("no panic").states[number as usize].way = way;
    Ok(2 * acts.len() as u64)
}

/// How long the longest way to the end is, or a state from which there is none. Those that were not looked at are passed over.
fn ways(seen: &Seen) -> Result<u32, u32> {
    const OPEN: u32 = u32::MAX;
    let mut lengths = vec![OPEN; seen.states.len()];
    let mut longest = 0;
    for start in 0..seen.states.len() {
        let (mut at, mut path) = (start, Vec::new());
        let length = loop {
            if lengths[at] != OPEN {
                break lengths[at];
            }
            path.push(at);
            match seen.states[at].way {
                Way::Unknown | Way::AtTheEnd => break 0,
                Way::On(_) if path.len() > 500 => return Err(start as u32),
                Way::On(next) => at = next as usize,
            }
        };
        for (more, place) in path.iter().rev().enumerate() {
            if lengths[*place] == OPEN {
                let ends = matches!(seen.states[*place].way, Way::Unknown | Way::AtTheEnd);
                lengths[*place] = if ends { 0 } else { length + more as u32 + 1 };
                longest = longest.max(lengths[*place]);
            }
        }
    }
    Ok(longest)
}

impl fmt::Display for Found {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} states, {} steps, depth {}, {:.1} s",
            self.states, self.steps, self.depth, self.seconds
        )?;
        match &self.violation {
            None if self.left == 0 => write!(
                f,
                ": the fixpoint; from each state at most {} cycles to a disabled axis",
                self.longest_way
            ),
            None => write!(f, ": out of time, {} states are left", self.left),
            Some((what, way)) => {
                write!(f, "\n  {what}")?;
                for (act, prompt) in way {
                    write!(f, "\n    {act:?}{}", if *prompt { "" } else { ", lazily" })?;
                }
                Ok(())
            }
        }
    }
}
