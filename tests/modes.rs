//! Random scenarios of an axis between its three modes, with frames lost, late and miscounted and stops at any time, judged by the
//! frames sent and by the simulated drive's ledgers. Each promise of `docs/motion.md` that is checked has a name here.
//!
//! `MODES_SEED=n cargo test --test modes` runs one scenario alone.
#![allow(missing_docs)]

mod common;

use core::time::Duration;

use common::frames::Random;
use common::{CYCLE, Link, Rig};
use servocrab::axis::{Command, CommandId, Completion, Event, Failure, Referencing, StopRequest};
use servocrab::coe::obj;
use servocrab::drives;
use servocrab::ds402::{Mode, State};
use servocrab::homing::{HomingCommand, HomingMethod};
use servocrab::profile_position::{MoveCommand, Reference, SetPoint};
use servocrab::profile_velocity::JogSetPoint;
use servocrab_sim::ds402::{AckFault, Behaviour, HomingOutcome, Machine, Plant};

const LIVES: u64 = 200;
const CYCLES: usize = 2_500;
/// Without commands and disturbances at the end, so that everything comes to its end.
const QUIET: usize = 1_500;

const MODES: [Mode; 3] = [Mode::ProfilePosition, Mode::Homing, Mode::ProfileVelocity];
const METHODS: [i8; 7] = [17, 18, 33, 34, 35, 37, 99];

/// A command, and what the axis knew when it was given.
struct Issued {
    id: CommandId,
    command: Command,
    at: Duration,
    referenced: bool,
}

/// A jog as its holder sees it.
struct Held {
    id: CommandId,
    velocity: i32,
}

struct Scenario {
    random: Random,
    rig: Rig,
    issued: Vec<Issued>,
    /// The time of every report seen so far.
    reported: Vec<Duration>,
    held: Option<Held>,
    link: (Link, u64),
    /// Mode and bit 4 of the frames that the drive got, the last two.
    delivered: [(i8, bool); 2],
    homed: usize,
    jogged: usize,
}

impl Scenario {
    fn new(seed: u64) -> Self {
        let mut random = Random::new(seed);
        let latency = random.below(4) as usize;
        let behaviour = Behaviour {
            machine: Machine {
                start: 4_000,
                negative_limit: Some(0),
                positive_limit: Some(9_000),
                index_period: 700,
                index_at: 13,
                ..Machine::default()
            },
            halt_keeps: !random.one_in(4),
            edge_at_mode_change: random.one_in(2),
            mode_change_cycles: random.below(6) as u32,
            homing_method_refused_at_write: false,
            quick_stop_option: random.pick(&[2, 6]),
            plant: Plant::seeded(seed),
            ..Behaviour::akd2g()
        };
        let mut description = drives::akd2g();
        for axis in &mut description.axes {
            axis.outputs.push(obj::TARGET_VELOCITY.into());
        }
        let option = behaviour.quick_stop_option;
        let mut rig = Rig::of(description, behaviour, |config| {
            config.referencing = Referencing::ByHoming;
            config.tolerances.settle = Duration::from_millis(30);
            config.deadlines.acknowledge = Duration::from_millis(60);
            config.deadlines.standstill = Duration::from_millis(600);
            config.deadlines.mode = Duration::from_millis(100);
            config.quick_stop = servocrab::ds402::QuickStopOption(option);
            // What comes back is this old: a drive that is slower by it.
            config.traits.drive_cycle = CYCLE * (1 + latency as u32);
        });
        rig.latency = latency;
        for (index, subindex, value) in [
            (0x6099, 1, 60_000),
            (0x6099, 2, 20_000),
            (0x609A, 0, 500_000),
        ] {
            rig.drive.set(index, subindex, value).unwrap();
        }
        Self {
            random,
            rig,
            issued: Vec::new(),
            reported: Vec::new(),
            held: None,
            link: (Link::Good, 0),
            delivered: [(1, false); 2],
            homed: 0,
            jogged: 0,
        }
    }

    fn send(&mut self, command: Command) -> CommandId {
        let referenced = self.rig.core.snapshot().referenced;
        let id = self.rig.send(command);
        self.issued.push(Issued {
            id,
            command,
            at: self.rig.now,
            referenced,
        });
        self.note_reports();
        id
    }

    /// Something that a program may do, whether it makes sense now or not.
    fn act(&mut self) {
        let status = self.rig.core.snapshot();
        match self.random.below(24) {
            0..4 if status.state != State::OperationEnabled => {
                let command = if status.state == State::Fault {
                    Command::ResetFault
                } else {
                    Command::Enable
                };
                self.send(command);
            }
            0..7 => {
                let mode = self.random.pick(&MODES);
                self.send(Command::SelectMode(mode));
            }
            // What belongs to the mode; now and then what does not.
            7..17 => match status.mode {
                _ if self.random.one_in(8) => self.jog(),
                _ if self.random.one_in(8) => self.home(),
                Mode::Homing => self.home(),
                Mode::ProfileVelocity => self.jog(),
                _ => self.start_move(),
            },
            17 => {
                self.send(Command::Halt);
            }
            18 | 19 => {
                self.send(Command::Resume);
            }
            20 => {
                let stop = self
                    .random
                    .pick(&[Command::Stop, Command::QuickStop, Command::Release]);
                self.send(stop);
            }
            21 if self.random.one_in(3) => {
                self.send(Command::Disable);
            }
            22 if self.random.one_in(4) => self.rig.drive.inject_fault(0x7305),
            _ => {
                let stops = [
                    StopRequest::HALT,
                    StopRequest::STOP,
                    StopRequest::QUICK_STOP,
                ];
                self.rig.stop = self.random.pick(&stops);
            }
        }
    }

    fn home(&mut self) {
        let method = self.random.pick(&METHODS);
        self.rig.drive.set(0x6098, 0, method.into()).unwrap();
        self.send(Command::Home(HomingCommand {
            method: HomingMethod(method),
            offset: None,
            until: None,
        }));
    }

    fn jog(&mut self) {
        let velocity = self.random.below(8_001) as i32 - 4_000;
        let id = self.send(Command::Jog(JogSetPoint::new(velocity)));
        // Refused, or held from now on.
        if self.rig.outcome(id).is_none() {
            assert!(self.held.is_none(), "two jogs are held");
            self.held = Some(Held { id, velocity });
            self.jogged += 1;
        }
    }

    fn start_move(&mut self) {
        let reference = self
            .random
            .pick(&[Reference::Absolute, Reference::Relative]);
        let target = self.random.below(2_001) as i32 - 1_000;
        self.send(Command::Move(MoveCommand {
            reference,
            target,
            set_point: SetPoint::new(),
            gated: false,
        }));
    }

    /// The holder of a jog changes its mind, or lets go.
    fn act_on_jog(&mut self) {
        let velocity = self.random.below(8_001) as i32 - 4_000;
        let release = self.random.one_in(4);
        let Some(held) = &mut self.held else { return };
        let (core, outputs) = (&mut self.rig.core, &mut self.rig.outputs);
        if release {
            assert!(core.release_jog(self.rig.now, held.id, outputs));
            self.held = None;
        } else {
            assert!(core.set_jog(held.id, velocity, outputs));
            held.velocity = velocity;
        }
    }

    fn disturb(&mut self) {
        if self.link.1 == 0 {
            let (link, length) = match self.random.below(60) {
                0 => (Link::RequestLost, 1 + self.random.below(5)),
                1 => (Link::ReplyLost, 1 + self.random.below(5)),
                2 => (Link::Miscounted, 1 + self.random.below(5)),
                3 if self.random.one_in(20) => (Link::RequestLost, 14),
                _ => (Link::Good, 1 + self.random.below(20)),
            };
            self.link = (link, length);
        }
        self.link.1 -= 1;
        let disturbances = self.rig.drive.disturbances();
        if self.random.one_in(80) {
            disturbances.deaf_to_bit_4 = self.random.one_in(4);
            disturbances.stale_reached_cycles = self.random.below(12) as u32;
            disturbances.ack = AckFault::default();
        }
    }

    fn cycle(&mut self, link: Link) -> Result<(), String> {
        let lane = self.rig.stop;
        let drives =
            self.rig.outputs[0] & 0x8F == 0x0F && !self.rig.core.snapshot().state.is_fault();
        self.rig.cycle_over(link);
        self.note_reports();
        self.judge_frame(link, lane, drives)
    }

    /// Whatever ended a jog: its holder hears of it, and lets go.
    fn note_reports(&mut self) {
        while self.reported.len() < self.rig.events.len() {
            let (id, event) = self.rig.events[self.reported.len()];
            self.reported.push(self.rig.now);
            if let Event::Done(result) = event {
                if self.held.as_ref().is_some_and(|held| held.id == id) {
                    self.held = None;
                }
                if let Ok(Completion::Homed { .. }) = result {
                    self.homed += 1;
                }
            }
        }
    }

    fn judge_frame(&mut self, link: Link, lane: StopRequest, drives: bool) -> Result<(), String> {
        let frame = &self.rig.sent;
        let word = u16::from_le_bytes([frame[0], frame[1]]);
        let mode = frame[2] as i8;
        let velocity = i32::from_le_bytes(frame[frame.len() - 4..].try_into().unwrap());
        let bit_4 = word & 0x10 != 0;
        if velocity != 0 {
            // Reports come after the frame: what ended a jog by them has it in this frame for the last time.
            let asked = self.held.as_ref().map(|held| held.velocity);
            let just_ended = self
                .rig
                .events
                .iter()
                .zip(&self.reported)
                .any(|(_, at)| *at == self.rig.now);
            if asked != Some(velocity) && !just_ended {
                return Err(format!(
                    "60FFh is {velocity}, the holder asks for {asked:?}"
                ));
            }
            if mode != 3 {
                return Err(format!("60FFh is {velocity} in mode {mode}"));
            }
            if !lane.is_empty() {
                return Err(format!("60FFh is {velocity} in the frame of {lane:?}"));
            }
        }
        if drives && lane.intersects(StopRequest::HALT | StopRequest::QUICK_STOP) {
            let stops = word & 0x100 != 0 || word & 0x04 == 0;
            if !stops {
                return Err(format!("{lane:?} is not in its frame: {word:#06x}"));
            }
        }
        if bit_4 && !matches!(mode, 1 | 6) {
            return Err(format!("bit 4 is high in mode {mode}"));
        }
        if link != Link::RequestLost {
            let [_, (last_mode, last_bit_4)] = self.delivered;
            if mode != last_mode && (bit_4 || last_bit_4) {
                return Err(format!(
                    "the mode changes from {last_mode} to {mode} with bit 4 {last_bit_4} → {bit_4}"
                ));
            }
            self.delivered = [self.delivered[1], (mode, bit_4)];
        }
        if self.rig.core.snapshot().referenced && !self.rig.drive.is_referenced() {
            return Err("the axis counts as referenced, the drive does not".to_owned());
        }
        Ok(())
    }

    fn live(&mut self) -> Result<(), String> {
        for _ in 0..CYCLES {
            if self.random.one_in(28) {
                self.act();
            }
            if self.random.one_in(40) {
                self.act_on_jog();
            }
            self.disturb();
            let link = self.link.0;
            self.cycle(link)?;
        }
        if let Some(held) = self.held.take() {
            let (core, outputs) = (&mut self.rig.core, &mut self.rig.outputs);
            assert!(core.release_jog(self.rig.now, held.id, outputs));
        }
        self.rig.stop = StopRequest::STOP;
        *self.rig.drive.disturbances() = Default::default();
        for _ in 0..QUIET {
            self.cycle(Link::Good)?;
        }
        self.judge_scenario()
    }

    fn judge_scenario(&self) -> Result<(), String> {
        if !self.rig.drive.stands() {
            return Err("the axis moves at the end".to_owned());
        }
        let mut lines = self.rig.drive.homings().iter().peekable();
        let mut homings = 0;
        for issued in &self.issued {
            let reports: Vec<_> = self
                .rig
                .events
                .iter()
                .zip(&self.reported)
                .filter(|((id, _), _)| *id == issued.id)
                .collect();
            let ends = reports
                .iter()
                .filter(|((_, event), _)| matches!(event, Event::Done(_)))
                .count();
            let Some(((_, Event::Done(result)), ended)) = reports.last() else {
                return Err(format!("{:?} has no end", issued.command));
            };
            if ends != 1 {
                return Err(format!("{:?} has {ends} ends", issued.command));
            }
            match issued.command {
                Command::Move(command) if command.reference == Reference::Absolute => {
                    let accepted = reports.len() > 1;
                    if accepted && !issued.referenced {
                        return Err(format!("{command:?} of an unreferenced axis"));
                    }
                }
                Command::Home(command) => {
                    // Its line in the ledger begins between its asking and its end; a frame may be on its way still.
                    let own = lines.next_if(|line| {
                        line.started_at >= issued.at && line.started_at <= **ended + CYCLE
                    });
                    homings += usize::from(own.is_some());
                    match (result, own.map(|line| line.outcome)) {
                        (Ok(Completion::Homed { .. }), Some(HomingOutcome::Attained)) => {}
                        // The drive has not seen bit 4, and would read the same if it had.
                        (Ok(Completion::Homed { position }), None)
                            if command.method.is_motionless() && position.abs() <= 10 =>
                        {
                            homings += 1;
                        }
                        (Ok(_), line) => {
                            return Err(format!(
                                "{:?} of {:?} ended at {ended:?} as {result:?}, but the drive: {line:?} of {:#?}",
                                issued.command,
                                issued.at,
                                self.rig.drive.homings()
                            ));
                        }
                        (Err(Failure::HomingError { .. }), Some(HomingOutcome::Failed(_)))
                        | (Err(_), None | Some(_)) => {}
                    }
                }
                _ => {}
            }
        }
        if let Some(line) = lines.next() {
            return Err(format!("{line:?} was asked for by nobody"));
        }
        if homings < self.homed {
            return Err(format!("{} homed, {homings} in the ledger", self.homed));
        }
        Ok(())
    }
}

#[test]
fn whatever_happens_homing_and_jog_keep_their_promises() {
    let alone: Option<u64> = std::env::var("MODES_SEED")
        .ok()
        .map(|seed| seed.parse().expect("MODES_SEED is a number"));
    let seeds = alone.map_or(0..LIVES, |seed| seed..seed + 1);
    let (mut homed, mut jogged) = (0, 0);
    for seed in seeds {
        let mut scenario = Scenario::new(seed);
        if let Err(what) = scenario.live() {
            let snapshot = scenario.rig.core.snapshot();
            panic!(
                "MODES_SEED={seed}: {what}\nat {:?}: {snapshot:?}",
                scenario.rig.now
            );
        }
        homed += scenario.homed;
        jogged += scenario.jogged;
    }
    println!("{homed} homings attained, {jogged} jogs");
    assert!(
        alone.is_some() || (homed > 60 && jogged > 200),
        "the scenarios meet what they are about: {homed} homings, {jogged} jogs"
    );
}
