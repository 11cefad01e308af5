//! An axis core and a simulated drive axis, stepped together in virtual time, without frames.
#![allow(missing_docs)]
#![allow(dead_code, reason = "each test file uses its own part of the rig")]

pub mod differential;
pub mod frames;

use core::time::Duration;

use servocrab::coe::AxisOffset;
use servocrab::drives::{self, DriveDescription};
use servocrab::ds402::{Mode, Statusword};
use servocrab::pdo_map::{Direction, Layout};
use servocrab::{
    Failure, Referencing, StopRequest,
    axis::{AxisFields, Command, CommandId, Completion, CoreConfig, Event},
};
use servocrab::{
    SetPoint,
    profile_position::{MoveCommand, Parameters, Reference},
};
use servocrab_sim::ds402::{Axis, Behaviour, Executed, Plant};

use frames::{Late, value};

/// Position window 6067h of the drives, in counts, and of the axes.
const WINDOW: i32 = 10;

pub const CYCLE: Duration = Duration::from_millis(1);

pub use differential::CorePair;
/// Whatever a test does, it does to an axis that steps cheaply and to one that computes every cycle as a whole.
pub use frames::Link;

pub struct Rig {
    pub core: CorePair,
    pub drive: Axis,
    pub now: Duration,
    pub outputs: Vec<u8>,
    /// The controlword of every frame sent, delivered or not.
    pub words: Vec<u16>,
    /// The outputs of the last frame sent.
    pub sent: Vec<u8>,
    pub events: Vec<(CommandId, Event)>,
    /// Inputs take this many cycles more to come.
    pub latency: usize,
    /// What the stop lane holds for the next frame.
    pub stop: StopRequest,
    /// What the next frame brings back as the statusword, whatever the drive shows.
    pub forged: Option<u16>,
    layout: Layout,
    late: Late,
    next_id: u32,
}

impl Rig {
    pub fn akd2g() -> Self {
        Self::new(Behaviour::akd2g(), |_| {})
    }

    /// A drive of this behaviour, and an axis of the library's AKD2G description changed by `change`.
    pub fn new(behaviour: Behaviour, change: impl FnOnce(&mut CoreConfig)) -> Self {
        Self::of(drives::akd2g(), behaviour, change)
    }

    /// A drive of this behaviour, and an axis of this description with its default mapping, changed by `change`.
    pub fn of(
        mut description: DriveDescription,
        behaviour: Behaviour,
        change: impl FnOnce(&mut CoreConfig),
    ) -> Self {
        description.axes.truncate(1);
        let layout = description.default_mapping().expect("a mapping").layout();
        let fields = AxisFields::from_layout(&layout, AxisOffset::of_axis(1)).expect("all fields");
        let mut config = CoreConfig::new(fields);
        config.referencing = Referencing::UnreferencedMovesAllowed;
        config.traits = description.traits;
        config.defaults = Parameters {
            velocity: Some(50_000),
            acceleration: Some(500_000),
            deceleration: Some(500_000),
            ..Parameters::default()
        };
        change(&mut config);
        Self {
            core: CorePair::new(config),
            drive: Axis::new(behaviour),
            now: Duration::ZERO,
            outputs: vec![0; layout.output_bytes()],
            words: Vec::new(),
            sent: Vec::new(),
            events: Vec::new(),
            latency: 0,
            stop: StopRequest::empty(),
            forged: None,
            layout,
            late: Late::default(),
            next_id: 0,
        }
    }

    /// An AKD2G in Operation enabled.
    pub fn enabled() -> Self {
        let mut rig = Self::akd2g();
        rig.enable();
        rig
    }

    /// The same on an ideal shaft.
    pub fn ideal_enabled() -> Self {
        let mut rig = Self::akd2g().ideal();
        rig.enable();
        rig
    }

    /// Hangs another plant on the drive than that of its behaviour.
    pub fn on_plant(mut self, plant: Plant) -> Self {
        self.drive.set_plant(plant);
        self
    }

    /// With a shaft that is exactly where its demand is: for the words and figures of a page.
    pub fn ideal(self) -> Self {
        self.on_plant(Plant::ideal())
    }

    /// Enables an axis that has been there for some time.
    pub fn enable(&mut self) {
        self.run(120);
        let id = self.send(Command::Enable);
        assert_eq!(self.finish(id), Ok(Completion::Done));
    }

    pub fn send(&mut self, command: Command) -> CommandId {
        self.next_id += 1;
        let id = CommandId(self.next_id);
        self.core.submit(self.now, id, command, &mut self.outputs);
        self.drain();
        id
    }

    pub fn abs(&mut self, target: i32, set_point: SetPoint) -> CommandId {
        self.move_with(Reference::Absolute, target, set_point)
    }

    pub fn rel(&mut self, distance: i32, set_point: SetPoint) -> CommandId {
        self.move_with(Reference::Relative, distance, set_point)
    }

    fn move_with(&mut self, reference: Reference, target: i32, set_point: SetPoint) -> CommandId {
        self.send(Command::Move(MoveCommand {
            reference,
            target,
            set_point,
            gated: false,
        }))
    }

    pub fn cycle(&mut self) {
        self.cycle_over(Link::Good);
    }

    /// One bus cycle: stop lane, frame out and back, core, and the drive's own cycle after it.
    pub fn cycle_over(&mut self, link: Link) {
        self.now += CYCLE;
        let stop = core::mem::take(&mut self.stop);
        if !stop.is_empty() {
            self.core.apply_stop(self.now, stop, &mut self.outputs);
            self.drain();
        }
        self.words
            .push(u16::from_le_bytes([self.outputs[0], self.outputs[1]]));
        self.sent.clone_from(&self.outputs);
        // A drive answers with what it put into its inputs before this frame passed.
        let inputs = self.inputs();
        self.forged = None;
        if link.delivers() {
            self.deliver();
        }
        let arrived = self.late.pass(inputs, self.latency);
        let inputs = link.tells(arrived.as_deref());
        self.core.step(self.now, inputs, &mut self.outputs);
        self.drain();
        self.drive.cycle(self.now);
    }

    pub fn run(&mut self, cycles: usize) {
        for _ in 0..cycles {
            self.cycle();
        }
    }

    /// Runs until the condition holds; fails after `cycles`.
    pub fn run_until(&mut self, cycles: usize, mut condition: impl FnMut(&Self) -> bool) {
        for _ in 0..cycles {
            if condition(self) {
                return;
            }
            self.cycle();
        }
        panic!(
            "not within {cycles} cycles; statusword {:#06x}, {:?}",
            self.drive.statusword(),
            self.core.snapshot()
        );
    }

    /// The command's last report, where it has come.
    pub fn outcome(&self, id: CommandId) -> Option<Result<Completion, Failure>> {
        self.events.iter().find_map(|&(of, event)| match event {
            Event::Done(result) if of == id => Some(result),
            _ => None,
        })
    }

    pub fn reports(&self, id: CommandId) -> Vec<Event> {
        self.events
            .iter()
            .filter(|(of, _)| *of == id)
            .map(|&(_, event)| event)
            .collect()
    }

    pub fn accepted(&self, id: CommandId) -> bool {
        self.events.contains(&(id, Event::Accepted))
    }

    /// Runs to the command's last report, for at most 30 s.
    pub fn finish(&mut self, id: CommandId) -> Result<Completion, Failure> {
        self.run_until(30_000, |rig| rig.outcome(id).is_some());
        self.outcome(id).expect("it has just been seen")
    }

    /// Runs to the end of the move, which is at this target within the window of the position.
    #[track_caller]
    pub fn assert_reached(&mut self, id: CommandId, target: i32) {
        let end = self.finish(id);
        let is_there = |position: i32| (position - target).abs() <= WINDOW;
        assert!(
            matches!(end, Ok(Completion::Reached { position }) if is_there(position)),
            "{end:?}, not at {target}"
        );
    }

    /// It rests, and goes on resting.
    #[track_caller]
    pub fn assert_rests(&mut self) {
        let stood = self.drive.position();
        self.run(1_000);
        let away = self.drive.position() - stood;
        assert!(away.abs() <= i64::from(WINDOW), "{away} counts");
    }

    /// The shaft is there within the window of the position.
    #[track_caller]
    pub fn assert_at(&self, position: i64) {
        let at = self.drive.position();
        let off = (at - position).abs();
        assert!(off <= i64::from(WINDOW), "{at}, not {position}");
    }

    /// Faster than what the drive itself takes for a standstill.
    pub fn moves(&self) -> bool {
        let standstill = self.drive.plant().standstill_velocity;
        self.drive.velocity().abs() > f64::from(standstill)
    }

    pub fn wait_accepted(&mut self, id: CommandId) {
        self.run_until(2_000, |rig| rig.accepted(id));
    }

    pub fn ledger(&self) -> &[Executed] {
        self.drive.ledger()
    }

    pub fn statusword(&self) -> Statusword {
        Statusword::from_bits_retain(self.drive.statusword())
    }

    pub fn mode(&self) -> Mode {
        self.core.snapshot().mode
    }

    /// The word in the outputs, sent with the next frame.
    pub fn word(&self) -> u16 {
        u16::from_le_bytes([self.outputs[0], self.outputs[1]])
    }

    /// The words of the frames since frame `from`, each run of the same word once.
    pub fn distinct_words(&self, from: usize) -> Vec<u16> {
        let mut words = self.words[from..].to_vec();
        words.dedup();
        words
    }

    fn drain(&mut self) {
        while let Some(event) = self.core.poll_event() {
            self.events.push(event);
        }
    }

    fn deliver(&mut self) {
        for (object, place) in self.layout.objects(Direction::Outputs) {
            let bytes = usize::from(place.bits / 8);
            let value = value(object.index, &self.outputs[place.byte..place.byte + bytes]);
            // A value that the drive refuses stays what it was, as with a PDO.
            let _ = self.drive.set(object.index, object.subindex, value);
        }
    }

    /// What the next frame brings back.
    pub fn inputs(&self) -> Vec<u8> {
        let mut image = vec![0; self.layout.input_bytes()];
        for (object, place) in self.layout.objects(Direction::Inputs) {
            let value = self.drive.get(object.index, object.subindex);
            let value = match self.forged {
                Some(word) if object.index == 0x6041 => word.into(),
                _ => value.expect("the drive has the object"),
            };
            let value = value.to_le_bytes();
            let bytes = usize::from(place.bits / 8);
            image[place.byte..place.byte + bytes].copy_from_slice(&value[..bytes]);
        }
        image
    }
}
