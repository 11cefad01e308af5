//! Breadth first, until no state is new; then whether each leads to the end.
//!
//! A state that waits for its turn is kept as the acts that led to it from one of those before it, which many share.

use core::fmt;
use std::io::Write;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use crate::world::{ACTS, Act, Description, Size, World};

pub struct Bounds {
    pub seconds: u64,
    /// What the states themselves may take: some 40 bytes each.
    pub states: usize,
    pub threads: usize,
    pub progress: bool,
}

#[derive(Default)]
pub struct Found {
    pub states: usize,
    pub steps: u64,
    pub depth: u32,
    pub seconds: f64,
    /// States whose next ones were not looked at.
    pub left: usize,
    /// The longest way from a state to a disabled axis, in cycles.
    pub longest_way: u32,
    /// The longest time for which a drive that does nothing keeps a command waiting, in cycles.
    pub longest_wait: u32,
    pub violation: Broken,
    /// The way to it.
    pub lines: Vec<String>,
}

/// A broken law, and the way to it from the first state.
pub type Broken = Option<(String, Vec<Move>)>;

/// A way for a person to read: what was sent in each cycle, what was seen, and what was told.
fn lived(description: Description, size: Size, way: &[Move]) -> Vec<String> {
    let mut world = World::new(description, size);
    world.told = Some(Vec::new());
    let line = |by: &Move| {
        let done = world.step(by.act(), by.is_prompt());
        let told = world.told.replace(Vec::new()).unwrap_or_default();
        format!("{by}: {world}{told:?} {}", done.err().unwrap_or_default())
    };
    way.iter().map(line).collect()
}

/// One cycle: the number of its act, and whether the drive does what it can at once.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Move(u8);

impl Move {
    const LAZY: u8 = 0x80;

    const fn new(act: u8, prompt: bool) -> Self {
        Self(if prompt { act } else { act | Self::LAZY })
    }

    const fn act(self) -> u8 {
        self.0 & !Self::LAZY
    }

    const fn is_prompt(self) -> bool {
        self.0 & Self::LAZY == 0
    }
}

impl fmt::Display for Move {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let act: Act = ACTS[usize::from(self.act())];
        write!(
            f,
            "{act:?}{}",
            if self.is_prompt() { "" } else { ", lazily" }
        )
    }
}

const NONE: u32 = u32::MAX;

/// The first of all acts is that nobody does anything.
const NOTHING: u8 = 0;

/// Where the way to the end leads from a state that was looked at; else it was not.
const AT_THE_END: u32 = u32::MAX - 1;

/// All states that were come to: their fingerprints, from where and by what, the next on the way to the end, and the next where the
/// drive does nothing that it has a choice in.
#[derive(Default)]
struct Seen {
    prints: Vec<u128>,
    before: Vec<u32>,
    moves: Vec<Move>,
    ways: Vec<u32>,
    waits: Vec<u32>,
    /// Numbers of states by fingerprint, in a table whose length is a power of two.
    table: Vec<u32>,
}

impl Seen {
    /// The number of a state, and whether it is new.
    fn number(&mut self, print: u128, before: u32, by: Move) -> (u32, bool) {
        if self.table.len() < self.prints.len() * 2 + 64 {
            self.grow();
        }
        let place = self.place(print);
        let number = self.table[place];
        if number != NONE {
            return (number, false);
        }
        let number = self.prints.len() as u32;
        self.table[place] = number;
        self.prints.push(print);
        self.before.push(before);
        self.moves.push(by);
        self.ways.push(NONE);
        self.waits.push(NONE);
        (number, true)
    }

    fn place(&self, print: u128) -> usize {
        let mask = self.table.len() - 1;
        let mut place = print as usize & mask;
        while self.table[place] != NONE && self.prints[self.table[place] as usize] != print {
            place = (place + 1) & mask;
        }
        place
    }

    fn grow(&mut self) {
        let length = (self.table.len() * 2).max(1 << 16);
        self.table.clear();
        self.table.resize(length, NONE);
        for number in 0..self.prints.len() {
            let place = self.place(self.prints[number]);
            self.table[place] = number as u32;
        }
    }

    fn way_to(&self, mut number: u32) -> Vec<Move> {
        let mut way = Vec::new();
        while self.before[number as usize] != NONE {
            way.push(self.moves[number as usize]);
            number = self.before[number as usize];
        }
        way.reverse();
        way
    }
}

/// How many cycles the longest way to the end takes, or a state from which none leads there. Those that were not looked at are
/// passed over.
fn longest(ways: &[u32]) -> Result<u32, u32> {
    const UNDER_WAY: u32 = NONE - 1;
    let mut lengths = vec![NONE; ways.len()];
    let mut longest = 0;
    let mut path = Vec::new();
    for start in 0..ways.len() {
        let mut at = start;
        path.clear();
        let mut length = loop {
            match (lengths[at], ways[at]) {
                // In a circle.
                (UNDER_WAY, _) => return Err(start as u32),
                (NONE, NONE | AT_THE_END) => {
                    lengths[at] = 0;
                    break 0;
                }
                (NONE, next) => {
                    lengths[at] = UNDER_WAY;
                    path.push(at);
                    at = next as usize;
                }
                (length, _) => break length,
            }
        };
        for &place in path.iter().rev() {
            length += 1;
            lengths[place] = length;
        }
        longest = longest.max(length);
    }
    Ok(longest)
}

/// So many cycles are lived again at most before a state is looked at.
const AGAIN: usize = 7;

/// A state that waits for its turn: from a world that others share, by these moves.
struct Waiting {
    from: Arc<World>,
    moves: [Move; AGAIN],
    count: u8,
    number: u32,
}

impl Waiting {
    fn world(&self) -> World {
        let mut world = World::clone(&self.from);
        for by in &self.moves[..usize::from(self.count)] {
            let done = world.step(by.act(), by.is_prompt());
            debug_assert!(done.is_ok(), "it was lived before");
        }
        world
    }
}

/// So many states are looked at before what is next is entered: the table is locked once for all of them.
const BATCH: usize = 256;

/// What one thread does with its part of a level.
struct Work<'a> {
    seen: &'a Mutex<Seen>,
    came: Vec<Waiting>,
    steps: u64,
    acts: Vec<u8>,
    /// What may come after the states of a batch: after which of them, and by what.
    next: Vec<(u128, Move, usize)>,
    looks: Vec<Look>,
}

/// What was seen of one state.
struct Look {
    /// The act that leads on to the end; none of a state that is there.
    end: Option<u8>,
    awaits: bool,
}

pub fn search(description: Description, size: Size, bounds: &Bounds) -> Found {
    let begin = Instant::now();
    let seen = Mutex::new(Seen::default());
    let is_over = || {
        let late = begin.elapsed().as_secs() >= bounds.seconds;
        late || lock(&seen).prints.len() >= bounds.states
    };
    let first = World::new(description, size);
    let print = first.around.print_after(&first.print_of_core());
    let (number, _) = lock(&seen).number(print, NONE, Move(0));
    let mut level = vec![Waiting {
        from: Arc::new(first),
        moves: [Move(0); AGAIN],
        count: 0,
        number,
    }];
    let mut found = Found::default();
    while !level.is_empty() && found.violation.is_none() && !is_over() {
        let part = level.len().div_ceil(bounds.threads.max(1));
        let parts = std::thread::scope(|scope| {
            let work: Vec<_> = level
                .chunks(part)
                .map(|states| {
                    let (seen, is_over) = (&seen, &is_over);
                    scope.spawn(move || {
                        let mut work = Work {
                            seen,
                            came: Vec::new(),
                            steps: 0,
                            acts: Vec::new(),
                            next: Vec::new(),
                            looks: Vec::new(),
                        };
                        for (done, batch) in states.chunks(BATCH).enumerate() {
                            if is_over() {
                                let left = states.len() - done * BATCH;
                                return (work.came, work.steps, left, None);
                            }
                            if let Err(broken) = work.expand(batch) {
                                return (work.came, work.steps, 0, Some(broken));
                            }
                        }
                        (work.came, work.steps, 0, None)
                    })
                })
                .collect();
            let done = work.into_iter().map(|work| work.join().expect("no panic"));
            done.collect::<Vec<_>>()
        });
        level.clear();
        for (mut came, steps, left, broken) in parts {
            level.append(&mut came);
            found.steps += steps;
            found.left += left;
            found.violation = found.violation.take().or(broken);
        }
        found.depth += 1;
        if bounds.progress {
            eprint!(
                "\r{} states, {} of them wait, depth {}, {:.0} s   ",
                lock(&seen).prints.len(),
                level.len(),
                found.depth,
                begin.elapsed().as_secs_f64()
            );
            let _ = std::io::stderr().flush();
        }
    }
    if bounds.progress {
        eprintln!();
    }
    found.left += level.len();
    let seen = seen.into_inner().expect("no panic");
    found.states = seen.prints.len();
    if found.violation.is_none() {
        for (ways, cycles, what) in [
            (
                &seen.ways,
                &mut found.longest_way,
                "a sound drive and a good cable do not lead from here to a disabled axis",
            ),
            (
                &seen.waits,
                &mut found.longest_wait,
                "a drive that does nothing is waited for without an end",
            ),
        ] {
            match longest(ways) {
                Ok(longest) => *cycles = longest,
                Err(number) => {
                    let broken = (what.into(), seen.way_to(number));
                    found.violation.get_or_insert(broken);
                }
            }
        }
        // At the fixpoint each state has been looked at.
        assert!(found.left > 0 || !seen.ways.contains(&NONE));
    }
    if let Some((_, way)) = &found.violation {
        found.lines = lived(description, size, way);
    }
    found.seconds = begin.elapsed().as_secs_f64();
    found
}

fn lock(seen: &Mutex<Seen>) -> std::sync::MutexGuard<'_, Seen> {
    seen.lock().expect("no panic in here")
}

impl Work<'_> {
    /// Everything that may happen next in these states.
    fn expand(&mut self, states: &[Waiting]) -> Result<(), (String, Vec<Move>)> {
        self.next.clear();
        self.looks.clear();
        for (place, state) in states.iter().enumerate() {
            if let Err((what, by)) = self.look_at(place, &state.world()) {
                let mut way = lock(self.seen).way_to(state.number);
                way.push(by);
                return Err((what, way));
            }
        }
        let mut seen = lock(self.seen);
        for (state, look) in states.iter().zip(&self.looks) {
            let number = state.number as usize;
            seen.ways[number] = look.end.map_or(AT_THE_END, |_| NONE);
            seen.waits[number] = if look.awaits { NONE } else { AT_THE_END };
        }
        let mut new = Vec::new();
        for &(print, by, place) in &self.next {
            let (state, look) = (&states[place], &self.looks[place]);
            let (next, is_new) = seen.number(print, state.number, by);
            if look.end.is_some_and(|end| by == Move::new(end, true)) {
                seen.ways[state.number as usize] = next;
            }
            // Where there is no choice there is no lazy one.
            if look.awaits && by.act() == NOTHING {
                seen.waits[state.number as usize] = next;
            }
            if is_new {
                new.push((by, next, place));
            }
        }
        drop(seen);
        let mut shared = None;
        for (by, number, place) in new {
            self.came
                .push(states[place].next(by, number, place, &mut shared));
        }
        Ok(())
    }

    /// Everything that may happen next in one.
    fn look_at(&mut self, place: usize, world: &World) -> Result<(), (String, Move)> {
        let end = world.way_to_the_end();
        world.acts(&mut self.acts);
        if !self.acts.contains(&end) {
            self.acts.push(end);
        }
        self.looks.push(Look {
            end: (!world.is_at_the_end()).then_some(end),
            awaits: world.awaits_an_answer(),
        });
        for &act in &self.acts {
            let (prompt, lazily) = (Move::new(act, true), Move::new(act, false));
            let mut after = world.clone();
            self.steps += 1;
            let seen = after.exchange(act).map_err(|what| (what, prompt))?;
            let core = after.print_of_core();
            let mut lazy = after.around.clone();
            after.drive(&seen, true).map_err(|what| (what, prompt))?;
            after
                .drive_lazily(&mut lazy, &seen)
                .map_err(|what| (what, lazily))?;
            let print = after.around.print_after(&core);
            self.next.push((print, prompt, place));
            if after.around != lazy {
                self.next.push((lazy.print_after(&core), lazily, place));
            }
        }
        Ok(())
    }
}

impl Waiting {
    /// The next state by this move. `shared`: the world of the state in this place, for those that would be too far from theirs.
    fn next(
        &self,
        by: Move,
        number: u32,
        place: usize,
        shared: &mut Option<(usize, Arc<World>)>,
    ) -> Self {
        let count = usize::from(self.count);
        let mut moves = self.moves;
        let (from, count) = if count < AGAIN {
            moves[count] = by;
            (Arc::clone(&self.from), count + 1)
        } else {
            moves[0] = by;
            let here = shared.take().filter(|(of, _)| *of == place);
            let here = here.unwrap_or_else(|| (place, Arc::new(self.world())));
            let from = Arc::clone(&here.1);
            *shared = Some(here);
            (from, 1)
        };
        Self {
            from,
            moves,
            count: count as u8,
            number,
        }
    }
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
                ": the fixpoint; from each state at most {} cycles to a disabled axis, and {} for an answer",
                self.longest_way, self.longest_wait
            ),
            None => write!(f, ": not the fixpoint, {} states are left", self.left),
            Some((what, _)) => {
                write!(f, "\n  {what}")?;
                let mut lines = self.lines.iter();
                lines.try_for_each(|line| write!(f, "\n    {line}"))
            }
        }
    }
}
