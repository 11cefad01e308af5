//! Whether an axis stands, on a drive whose encoder is that of a motor: it is never quite still.

use core::time::Duration;

use servocrab::ds402::{Mode, QuickStopOption, State, StopOptions};
use servocrab::{
    Failure, Referencing, StopRequest,
    axis::{
        AxisCore, AxisFields, Command, CommandId, Completion, CoreConfig, Deadlines, Event, Inputs,
        Unsupported, WaitingFor,
    },
};
use servocrab::{
    SetPoint,
    profile_position::{MoveCommand, Reference},
};

const HALT: u16 = 1 << 8;

/// A drive that does what a word says, with a motor whose inputs have noise.
struct Plant {
    core: AxisCore,
    outputs: [u8; 6],
    events: Vec<(CommandId, Event)>,
    now: Duration,
    cycle: Duration,
    word: u16,
    state: u16,
    acknowledged: bool,
    position: f64,
    /// Counts a second, and what of it is lost in a second when it stops.
    velocity: f64,
    deceleration: f64,
    /// Of the encoder, in counts.
    noise: i32,
    seed: u32,
    next: u32,
    /// Its inputs stay as they were last.
    frozen: bool,
    inputs: [u8; 6],
}

impl Plant {
    fn new(change: impl FnOnce(&mut CoreConfig)) -> Self {
        let mut config = CoreConfig::new(AxisFields::at(0, 0));
        config.quick_stop = QuickStopOption(6);
        config.referencing = Referencing::AbsoluteEncoder;
        change(&mut config);
        let mut plant = Self {
            core: AxisCore::new(config),
            outputs: [0; 6],
            events: Vec::new(),
            now: Duration::ZERO,
            cycle: Duration::from_millis(1),
            word: 0,
            state: 0x0250,
            acknowledged: false,
            position: 0.0,
            velocity: 0.0,
            deceleration: 200_000.0,
            noise: 0,
            seed: 1,
            next: 0,
            frozen: false,
            inputs: [0; 6],
        };
        plant.core.note_mode(Mode::ProfilePosition);
        plant.run(200);
        let enable = plant.send(Command::Enable);
        assert_eq!(plant.finish(enable), Ok(Completion::Done));
        plant
    }

    /// On its way at this velocity, with a set-point that it never reaches.
    fn moving(velocity: f64, change: impl FnOnce(&mut CoreConfig)) -> Self {
        let mut plant = Self::new(change);
        plant.send(Command::Move(MoveCommand {
            reference: Reference::Absolute,
            target: 1_000_000_000,
            set_point: SetPoint::new(),
            gated: false,
        }));
        plant.run(20);
        plant.velocity = velocity;
        plant.run(200);
        assert!(plant.core.snapshot().has_set_point);
        plant
    }

    fn send(&mut self, command: Command) -> CommandId {
        self.next += 1;
        let id = CommandId(self.next);
        self.core.submit(self.now, id, command, &mut self.outputs);
        id
    }

    fn random(&mut self, amplitude: i32) -> i32 {
        self.seed = self
            .seed
            .wrapping_mul(1_664_525)
            .wrapping_add(1_013_904_223);
        let span = 2 * amplitude + 1;
        (self.seed >> 16) as i32 % span - amplitude
    }

    fn step(&mut self) {
        self.now += self.cycle;
        let position = self.position as i32 + self.random(self.noise);
        let shown = self.state | u16::from(self.acknowledged) << 12;
        let inputs = &mut self.inputs;
        if !self.frozen {
            inputs[..2].copy_from_slice(&shown.to_le_bytes());
            inputs[2..].copy_from_slice(&position.to_le_bytes());
        }
        self.word = u16::from_le_bytes([self.outputs[0], self.outputs[1]]);
        self.obey();
        self.core
            .step(self.now, Inputs::Fresh(&self.inputs), &mut self.outputs);
        while let Some(event) = self.core.poll_event() {
            self.events.push(event);
        }
        self.position += self.velocity * self.cycle.as_secs_f64();
    }

    /// Bit 10 is never set.
    fn obey(&mut self) {
        self.state = match (self.state, self.word & 0x000F) {
            (0x0250, 0x06) => 0x0231,
            (0x0231, 0x07) => 0x0233,
            (0x0233, 0x0F) => 0x0237,
            (0x0237, 0x0B) => 0x0217,
            (0x0237, 0x06) => 0x0231,
            (_, word) if word & 2 == 0 => 0x0250,
            (state, _) => state,
        };
        self.acknowledged = self.state == 0x0237 && self.word & 1 << 4 != 0;
        if self.word & HALT != 0 || self.state != 0x0237 {
            let less = self.deceleration * self.cycle.as_secs_f64();
            self.velocity = if self.velocity > less {
                self.velocity - less
            } else {
                0.0
            };
        }
    }

    fn run(&mut self, cycles: usize) {
        for _ in 0..cycles {
            self.step();
        }
    }

    fn outcome(&self, id: CommandId) -> Option<Result<Completion, Failure>> {
        self.events.iter().find_map(|&(of, event)| match event {
            Event::Done(result) if of == id => Some(result),
            _ => None,
        })
    }

    fn finish(&mut self, id: CommandId) -> Result<Completion, Failure> {
        for _ in 0..30_000 {
            if let Some(result) = self.outcome(id) {
                return result;
            }
            self.step();
        }
        panic!("it has no end");
    }

    /// Runs to the end of this command; gives the cycles for which the axis had stood by then.
    fn stood_at_the_end_of(&mut self, id: CommandId) -> usize {
        let mut stood = 0;
        while self.outcome(id).is_none() {
            self.step();
            stood = if self.velocity == 0.0 { stood + 1 } else { 0 };
        }
        assert!(
            matches!(self.outcome(id), Some(Ok(Completion::Stopped { .. }))),
            "{:?}",
            self.outcome(id)
        );
        stood
    }
}

const STOPS: [Command; 4] = [
    Command::Halt,
    Command::QuickStop,
    Command::Stop,
    Command::Disable,
];

#[test]
fn a_stop_is_done_when_the_position_has_stayed_within_its_window_for_the_settle_time() {
    for noise in [0, 1, 3] {
        for command in STOPS {
            let mut plant = Plant::moving(40_000.0, |_| {});
            plant.noise = noise;
            let id = plant.send(command);
            // The last 10 ms of its ramp lie within the window, too; quick stop may come after the halt.
            let stood = plant.stood_at_the_end_of(id);
            assert!((90..=110).contains(&stood), "{command:?}, {noise}: {stood}");
        }
    }
}

/// A shaking axis: at the deadline it loses its power all the same.
#[test]
fn a_standstill_that_does_not_come_ends_without_power_and_says_what_was_seen() {
    for command in [Command::QuickStop, Command::Stop, Command::Disable] {
        let mut plant = Plant::moving(40_000.0, |_| {});
        plant.noise = 40;
        let asked = plant.now;
        let id = plant.send(command);
        let failure = plant.finish(id).unwrap_err();
        let Failure::Timeout {
            waiting_for: WaitingFor::Standstill(seen),
            ..
        } = failure
        else {
            panic!("{command:?}: {failure}");
        };
        assert_eq!(seen.positions.1 - seen.positions.0, 80, "{seen}");
        let took = plant.now - asked;
        let deadline = Deadlines::default().standstill;
        assert!(took <= deadline + Duration::from_millis(5), "{took:?}");
        plant.step();
        assert_eq!(plant.word & 0x000F, 0, "{command:?}");
        let text = failure.to_string();
        assert!(text.contains("to stay within 10 for 100 ms"), "{text}");
    }
}

#[test]
fn samples_before_and_after_a_stall_do_not_show_that_it_stood_in_between() {
    // One position just before the stall and the same after it, and the axis is turning all the time.
    let mut plant = Plant::moving(40_000.0, |_| {});
    let id = plant.send(Command::QuickStop);
    plant.deceleration = 0.0;
    plant.run(20);
    assert_eq!(plant.core.snapshot().state, State::QuickStopActive);
    let stuck = plant.position;
    for _ in 0..3 {
        plant.position = stuck;
        plant.cycle = Duration::from_millis(200);
        plant.step();
        plant.cycle = Duration::from_millis(1);
        plant.position = stuck;
        plant.step();
    }
    assert_eq!(plant.outcome(id), None);
    plant.run(200);
    assert_eq!(plant.outcome(id), None);
}

#[test]
fn slow_cycles_need_five_samples() {
    let mut plant = Plant::new(|_| {});
    plant.cycle = Duration::from_millis(60);
    plant.velocity = 40_000.0;
    plant.run(5);
    let id = plant.send(Command::QuickStop);
    plant.velocity = 0.0;
    let stood = plant.stood_at_the_end_of(id);
    assert!((4..=8).contains(&stood), "{stood}");
}

#[test]
fn where_605dh_is_0_bit_8_is_never_sent_and_every_stop_is_a_quick_stop_at_once() {
    let coasts = |config: &mut CoreConfig| {
        config.stop_options = StopOptions {
            halt: Some(0),
            ..StopOptions::default()
        };
    };
    let mut plant = Plant::moving(40_000.0, coasts);
    let refused = plant.send(Command::Halt);
    plant.step();
    assert_eq!(
        plant.outcome(refused),
        Some(Err(Failure::Unsupported(Unsupported::Halt)))
    );
    assert_eq!(plant.word & 0x10F, 0x0F);
    for command in [Command::Stop, Command::Disable, Command::Release] {
        let mut plant = Plant::moving(40_000.0, coasts);
        let id = plant.send(command);
        plant.step();
        assert_eq!(plant.word & 0x10F, 0x0B, "{command:?}");
        assert!(plant.stood_at_the_end_of(id) > 0);
    }
    for stop in [StopRequest::HALT, StopRequest::STOP] {
        let mut plant = Plant::moving(40_000.0, coasts);
        plant.core.apply_stop(plant.now, stop, &mut plant.outputs);
        plant.step();
        assert_eq!(plant.word & 0x10F, 0x0B, "{stop:?}");
    }
}

#[test]
fn a_position_that_is_new_only_once_in_four_of_the_drives_cycles_shows_no_rest() {
    // Its inputs stay for three of its cycles: longer than the settle time.
    let mut plant = Plant::moving(40_000.0, |config| {
        config.tolerances.settle = Duration::from_millis(20);
        config.traits.drive_cycle = Duration::from_millis(8);
    });
    let id = plant.send(Command::Halt);
    plant.run(10);
    plant.frozen = true;
    plant.run(24);
    plant.frozen = false;
    assert_eq!(plant.outcome(id), None);
    assert!(plant.velocity > 10_000.0);
    let stood = plant.stood_at_the_end_of(id);
    // The last 10 ms of its ramp lie within the window, too.
    assert!((22..=40).contains(&stood), "{stood}");
}
