//! Axes that seem to stand now and then, on drives that take their time to switch off: a power that is on its way out stays so.
#![allow(missing_docs)]

use core::{f64::consts::TAU, time::Duration};

use servocrab::axis::{
    AxisCore, AxisFields, Command, CommandId, CoreConfig, Deadlines, Event, Failure, Inputs,
    Referencing, WaitingFor,
};
use servocrab::ds402::{Mode, QuickStopOption};
use servocrab::profile_position::{MoveCommand, Reference, SetPoint};

const CYCLE: Duration = Duration::from_millis(1);
const STANDSTILL: u64 = 4_000;
const BIT_4: u16 = 1 << 4;
const HALT: u16 = 1 << 8;

const SWITCH_ON_DISABLED: u16 = 0x0250;
const ENABLED: u16 = 0x0237;
const QUICK_STOP_ACTIVE: u16 = 0x0217;

/// What 6064h shows beside the shaft; times in ms, amplitudes in counts. The position window has 10.
#[derive(Debug, Clone, Copy)]
enum Unrest {
    Swing { period: u32, amplitude: f64 },
    Noise { amplitude: u32 },
}

/// A drive with 605Ah = 6 and its axis, after CiA 402.
struct Drive {
    state: u16,
    word: u16,
    position: f64,
    /// Counts a millisecond.
    speed: f64,
    /// How long it takes to switch off, while the word says so all the time.
    switch_off: u64,
    switching_off: u64,
    deaf_to_quick_stop: bool,
}

impl Drive {
    fn is_powered(&self) -> bool {
        matches!(self.state, ENABLED | QUICK_STOP_ACTIVE)
    }

    fn cycle(&mut self, word: u16) {
        let rises = word & !self.word & BIT_4 != 0;
        self.word = word;
        if self.state == ENABLED && rises {
            self.speed = 10.0;
        }
        if !self.is_powered() || self.state == QUICK_STOP_ACTIVE || word & HALT != 0 {
            self.speed = (self.speed - 0.02).max(0.0);
        }
        self.position += self.speed;
        let to = match (self.state, word & 0x8F) {
            (ENABLED, word) if word & 0x06 == 0x02 && self.deaf_to_quick_stop => ENABLED,
            (ENABLED, word) if word & 0x06 == 0x02 => QUICK_STOP_ACTIVE,
            (QUICK_STOP_ACTIVE, word) if word & 0x02 != 0 => QUICK_STOP_ACTIVE,
            (_, word) if word & 0x06 != 0x06 => SWITCH_ON_DISABLED,
            (SWITCH_ON_DISABLED, 0x06) | (0x0233 | ENABLED, 0x06) => 0x0231,
            (0x0231, 0x07) => 0x0233,
            (0x0233, 0x0F) => ENABLED,
            (state, _) => state,
        };
        let switches_off = self.is_powered() && !matches!(to, ENABLED | QUICK_STOP_ACTIVE);
        self.switching_off = if switches_off {
            self.switching_off + 1
        } else {
            0
        };
        if !switches_off || self.switching_off > self.switch_off {
            self.state = to;
        }
    }
}

struct Bench {
    core: AxisCore,
    drive: Drive,
    outputs: [u8; 6],
    now: u64,
    unrest: Option<Unrest>,
    seed: u32,
    /// Its outputs do not reach the drive, which answers all the same.
    undelivered: bool,
    events: Vec<(CommandId, Event)>,
    next: u32,
}

impl Bench {
    fn new(switch_off: u64) -> Self {
        let mut config = CoreConfig::new(AxisFields::at(0, 0));
        config.quick_stop = QuickStopOption(6);
        config.referencing = Referencing::AbsoluteEncoder;
        config.deadlines = Deadlines {
            standstill: Duration::from_millis(STANDSTILL),
            ..Deadlines::default()
        };
        let mut bench = Self {
            core: AxisCore::new(config),
            drive: Drive {
                state: SWITCH_ON_DISABLED,
                word: 0,
                position: 0.0,
                speed: 0.0,
                switch_off,
                switching_off: 0,
                deaf_to_quick_stop: false,
            },
            outputs: [0; 6],
            now: 0,
            unrest: None,
            seed: 1,
            undelivered: false,
            events: Vec::new(),
            next: 0,
        };
        bench.core.note_mode(Mode::ProfilePosition);
        bench.run(200);
        bench.send(Command::Enable);
        bench.run(200);
        assert_eq!(bench.drive.state, ENABLED);
        bench
    }

    /// The same on its way.
    fn moving(switch_off: u64) -> Self {
        let mut bench = Self::new(switch_off);
        bench.send(Command::Move(MoveCommand {
            reference: Reference::Absolute,
            target: 1_000_000_000,
            set_point: SetPoint::new(),
            gated: false,
        }));
        bench.run(300);
        assert!(bench.drive.speed > 0.0);
        bench
    }

    fn send(&mut self, command: Command) -> CommandId {
        self.next += 1;
        let id = CommandId(self.next);
        let now = CYCLE * self.now as u32;
        self.core.submit(now, id, command, &mut self.outputs);
        id
    }

    fn unrest(&mut self) -> f64 {
        match self.unrest {
            None => 0.0,
            Some(Unrest::Swing { period, amplitude }) => {
                let turns = self.now as f64 / f64::from(period);
                amplitude * (TAU * turns).sin()
            }
            Some(Unrest::Noise { amplitude }) => {
                self.seed = self
                    .seed
                    .wrapping_mul(1_664_525)
                    .wrapping_add(1_013_904_223);
                f64::from((self.seed >> 16) % (2 * amplitude + 1)) - f64::from(amplitude)
            }
        }
    }

    fn run(&mut self, cycles: u64) {
        for _ in 0..cycles {
            self.now += 1;
            let acknowledge = self.drive.state == ENABLED && self.drive.word & BIT_4 != 0;
            let statusword = self.drive.state | u16::from(acknowledge) << 12;
            let position = (self.drive.position + self.unrest()).round() as i32;
            let mut inputs = [0; 6];
            inputs[..2].copy_from_slice(&statusword.to_le_bytes());
            inputs[2..].copy_from_slice(&position.to_le_bytes());
            let word = if self.undelivered {
                self.drive.word
            } else {
                self.word()
            };
            self.drive.cycle(word);
            let inputs = if self.undelivered {
                Inputs::Answered(&inputs)
            } else {
                Inputs::Fresh(&inputs)
            };
            self.core
                .step(CYCLE * self.now as u32, inputs, &mut self.outputs);
            while let Some(event) = self.core.poll_event() {
                self.events.push(event);
            }
        }
    }

    /// The word that is sent next.
    fn word(&self) -> u16 {
        u16::from_le_bytes([self.outputs[0], self.outputs[1]])
    }

    /// After how many cycles the drive has switched off.
    fn until_off(&mut self) -> u64 {
        let from = self.now;
        while self.drive.is_powered() {
            self.run(1);
            assert!(self.now - from < 60_000, "it keeps its power");
        }
        self.now - from
    }

    fn result(&mut self, id: CommandId) -> Result<(), Failure> {
        self.run(20);
        let result = self.events.iter().find_map(|&(of, event)| match event {
            Event::Done(result) if of == id => Some(result),
            _ => None,
        });
        result.expect("it has an end").map(|_| ())
    }

    fn assert_never_stood(&mut self, id: CommandId) {
        let result = self.result(id);
        let Err(Failure::Timeout { waiting_for, .. }) = result else {
            panic!("{result:?}");
        };
        assert!(
            matches!(waiting_for, WaitingFor::Standstill(_)),
            "{result:?}"
        );
    }
}

/// At its turns such an axis stays within the window for the settle time. Then it goes on, while its drive still shows its power.
#[test]
fn an_axis_that_seems_to_stand_at_its_turns_is_switched_off_at_one_of_them() {
    for period in [333, 1_000] {
        for switch_off in [0, 100, 300] {
            for moving in [false, true] {
                let mut bench = if moving {
                    Bench::moving(switch_off)
                } else {
                    Bench::new(switch_off)
                };
                let amplitude = 30.0;
                bench.unrest = Some(Unrest::Swing { period, amplitude });
                bench.run(150);
                let disable = bench.send(Command::Disable);
                let took = bench.until_off();
                let case = format!("{period} {switch_off} {moving}: {took}");
                assert!(took < STANDSTILL + switch_off, "{case}");
                bench.run(1_000);
                assert_eq!(bench.result(disable), Ok(()), "{case}");
                assert_eq!(bench.word(), 0, "{case}");
            }
        }
    }
}

#[test]
fn a_disable_out_of_quick_stop_active_ends_without_power_though_the_axis_begins_to_shake() {
    for unrest in [
        Unrest::Noise { amplitude: 20 },
        Unrest::Swing {
            period: 125,
            amplitude: 30.0,
        },
        Unrest::Swing {
            period: 333,
            amplitude: 30.0,
        },
    ] {
        let mut bench = Bench::moving(300);
        let stop = bench.send(Command::Stop);
        bench.run(1_500);
        assert_eq!(bench.result(stop), Ok(()));
        assert_eq!(bench.drive.state, QUICK_STOP_ACTIVE);
        bench.send(Command::Disable);
        bench.run(100);
        bench.unrest = Some(unrest);
        let took = bench.until_off();
        assert!(took <= STANDSTILL + 310, "{unrest:?}: {took}");
    }
}

#[test]
fn an_axis_that_begins_to_shake_while_it_is_shut_down_loses_its_power_at_the_deadline() {
    let mut bench = Bench::new(300);
    let disable = bench.send(Command::Disable);
    bench.run(150);
    bench.unrest = Some(Unrest::Noise { amplitude: 20 });
    let took = bench.until_off();
    assert!((STANDSTILL..STANDSTILL + 310).contains(&took), "{took}");
    bench.assert_never_stood(disable);
}

/// It stays in Operation enabled.
#[test]
fn a_shaking_axis_whose_drive_ignores_quick_stop_loses_its_power_at_the_deadline_too() {
    for command in [Command::Disable, Command::Stop, Command::QuickStop] {
        for moving in [false, true] {
            let mut bench = if moving {
                Bench::moving(0)
            } else {
                Bench::new(0)
            };
            bench.drive.deaf_to_quick_stop = true;
            if moving {
                let halt = bench.send(Command::Halt);
                bench.run(1_000);
                assert_eq!(bench.result(halt), Ok(()));
            }
            bench.unrest = Some(Unrest::Noise { amplitude: 20 });
            bench.run(150);
            let id = bench.send(command);
            let took = bench.until_off();
            let case = format!("{command:?} {moving}: {took}");
            assert!((STANDSTILL..STANDSTILL + 6).contains(&took), "{case}");
            assert_eq!(bench.result(id), Err(Failure::QuickStopIgnored), "{case}");
        }
    }
}

/// What the drive has not got has not had its time.
#[test]
fn a_quick_stop_that_is_delivered_after_its_deadline_has_its_whole_time_from_then_on() {
    let mut bench = Bench::moving(0);
    bench.unrest = Some(Unrest::Noise { amplitude: 20 });
    bench.undelivered = true;
    bench.send(Command::QuickStop);
    bench.run(STANDSTILL + 1_000);
    assert_eq!(bench.drive.state, ENABLED);
    bench.undelivered = false;
    let took = bench.until_off();
    assert!((STANDSTILL..STANDSTILL + 6).contains(&took), "{took}");
}
