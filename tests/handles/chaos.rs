//! Random commands, drops and lost cycles: every future resolves, and the ledger has each move as often as was said.

use servocrab::{
    Axis, AxisError, BufferMode, Doubt, Failure, Move, ProfilePosition, SetPoint, axis::Delivery,
};

use servocrab_sim::{Faults, FaultyLine, Segment, personality};

use crate::machine::{Machine, Task};

/// A small generator of its own (xorshift64), so that a seed stays the same sequence for ever.
struct Random(u64);

impl Random {
    fn below(&mut self, n: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 % n
    }
}

/// One move that was asked for: known by its target, which no other has.
struct Asked<'a> {
    target: i32,
    sending: Option<Task<'a, Result<Move, AxisError>>>,
    accepted: Option<Move>,
    refused: Option<AxisError>,
}

type Command<'a> = Task<'a, Result<(), AxisError>>;

fn command<'a>(axis: &'a Axis, random: &mut Random) -> Command<'a> {
    match random.below(8) {
        0 => Task::new(axis.disable()),
        1 => Task::new(async { axis.quick_stop().await.map(drop) }),
        2 => Task::new(async { axis.stop().await.map(drop) }),
        3 => Task::new(axis.halt()),
        4 | 5 => Task::new(axis.resume()),
        6 => Task::new(axis.reset_fault()),
        _ => Task::new(axis.enable()),
    }
}

fn ask(pp: &ProfilePosition, target: i32, buffer_mode: BufferMode) -> Asked<'_> {
    Asked {
        target,
        sending: Some(Task::new(
            pp.move_abs(target, SetPoint::new().buffer_mode(buffer_mode)),
        )),
        accepted: None,
        refused: None,
    }
}

/// A line with the simulator's faults, on which one frame passes in each cycle: it says in which ones there is an answer.
struct Line(FaultyLine);

impl Line {
    /// BRD of the AL status.
    const FRAME: [u8; 31] = [
        0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x10, 0, 0, 0, 0, 1, 0x88, 0xA4, 14, 0x10, 7, 0, 0, 0,
        0x30, 0x01, 2, 0, 0, 0, 0, 0, 0, 0, 0,
    ];

    fn new(seed: u64) -> Self {
        let faults: Faults = "plant=seeded,loss=4%,reply-loss=4%".parse().unwrap();
        let segment = Segment::new().with(personality::akd2g());
        Self(FaultyLine::new(segment, &faults.seed(seed)).unwrap())
    }

    fn answers(&mut self, machine: &Machine) -> bool {
        self.0.send(&Self::FRAME, machine.now);
        self.0.receive(machine.now).is_some()
    }
}

fn live(seed: u64) -> (usize, usize) {
    let mut random = Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
    let (mut machine, axis) = Machine::enabled();
    let mut line = Line::new(seed);
    let plant = *line.0.segment().device(0).unwrap().axes()[0].plant();
    machine.drive().set_plant(plant);
    let pp = machine.finish(axis.profile_position()).unwrap();
    let mut moves: Vec<Asked<'_>> = Vec::new();
    let mut commands: Vec<Command<'_>> = Vec::new();
    // From calm to hostile: what comes once in so many cycles.
    let rate = 400 >> (seed % 5);
    for _ in 0..1_000 {
        match random.below(rate) {
            0..4 => {
                let starts = [
                    BufferMode::Aborting,
                    BufferMode::Buffered,
                    BufferMode::Blending,
                ];
                let start = starts[random.below(3) as usize];
                let target = 1_000 * random.below(5) as i32 + moves.len() as i32;
                moves.push(ask(&pp, target, start));
            }
            4 if random.below(4) == 0 => commands.push(command(&axis, &mut random)),
            4 | 5 => commands.push(Task::new(axis.enable())),
            6 if random.below(4) == 0 => axis.stop_handle().halt(),
            6 => commands.push(Task::new(axis.resume())),
            7 => {
                let dropped = random.below(moves.len().max(1) as u64) as usize;
                if let Some(asked) = moves.get_mut(dropped) {
                    asked.sending = None;
                }
            }
            8 if random.below(4) == 0 => machine.drive().inject_fault(0x7500),
            8 => commands.push(Task::new(axis.reset_fault())),
            _ => {}
        }
        machine.silent = !line.answers(&machine);
        machine.cycle();
        for asked in &mut moves {
            if let Some(result) = asked.sending.as_mut().and_then(Task::poll) {
                asked.sending = None;
                match result {
                    Ok(accepted) => asked.accepted = Some(accepted),
                    Err(error) => asked.refused = Some(error),
                }
            }
        }
        commands.retain_mut(|command| command.poll().is_none());
    }
    machine.silent = true;
    machine.run(40);
    assert!(
        commands.iter_mut().all(|command| command.poll().is_some()),
        "seed {seed}: a command never ended"
    );
    let mut executed = 0;
    let count = moves.len();
    for mut asked in moves {
        if let Some(result) = asked.sending.as_mut().map(Task::poll) {
            match result {
                Some(Ok(accepted)) => asked.accepted = Some(accepted),
                Some(Err(error)) => asked.refused = Some(error),
                None => panic!("seed {seed}: the move to {} never ended", asked.target),
            }
        }
        let drive = machine.drive();
        let in_ledger = drive
            .ledger()
            .iter()
            .filter(|entry| entry.value == asked.target)
            .count();
        let context = format!("seed {seed}, move to {}", asked.target);
        if let Some(accepted) = asked.accepted {
            assert_eq!(in_ledger, 1, "{context}: accepted");
            match accepted.outcome() {
                None => panic!("{context}: no outcome"),
                Some(Ok(_)) => executed += 1,
                Some(Err(_)) => {}
            }
        } else if let Some(error) = asked.refused {
            let may_be_there = matches!(
                error.failure(),
                Some(
                    Failure::BusLost {
                        delivery: Delivery::Unknown | Delivery::Accepted
                    } | Failure::Unknown {
                        doubt: Doubt::Unacknowledged,
                        ..
                    } | Failure::Fault { .. }
                        | Failure::Disabled { .. }
                        | Failure::QuickStopped { .. }
                )
            );
            assert!(
                in_ledger == 0 || (may_be_there && in_ledger == 1),
                "{context}: {error}, and {in_ledger} in the ledger"
            );
        } else {
            assert!(in_ledger <= 1, "{context}: dropped");
        }
    }
    (count, executed)
}

#[test]
fn every_future_resolves_and_the_ledger_agrees_whatever_is_asked_dropped_or_lost() {
    let (mut asked, mut reached) = (0, 0);
    for seed in 0..900 {
        let (moves, arrived) = live(seed);
        asked += moves;
        reached += arrived;
    }
    assert!(
        asked > 10_000 && reached > 400,
        "{asked} asked, {reached} reached: too little to prove anything"
    );
}
