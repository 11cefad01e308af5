//! The pure rooms in a program without std: an axis is enabled, and moved to its target, by its statuswords.
//! It ends with 0, or with the number of the step that failed.
#![no_std]
#![no_main]

use core::time::Duration;

use servocrab::{
    Referencing,
    axis::{AxisCore, AxisFields, Command, CommandId, Completion, CoreConfig, Event, Inputs},
};
use servocrab::{
    SetPoint,
    profile_position::{MoveCommand, Reference},
};

const CYCLE: Duration = Duration::from_millis(1);
const OUTPUTS: usize = 7;
const INPUTS: usize = 7;

#[global_allocator]
static ALLOCATOR: libc_alloc::LibcAlloc = libc_alloc::LibcAlloc;

// The C library of the system, for what a compiler may call: `memcpy` and the like. And the entry.
#[link(name = "c")]
unsafe extern "C" {}

/// What core and alloc name, as they are shipped for programs that unwind. This one does not.
#[unsafe(no_mangle)]
extern "C" fn rust_eh_personality() {}

#[panic_handler]
fn panicked(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}

/// A drive that does at once what it is told.
struct Drive {
    status: u16,
    position: i32,
    before: u16,
}

impl Drive {
    fn step(&mut self, outputs: &[u8; OUTPUTS]) -> [u8; INPUTS] {
        let [low, high, a, b, c, d, _] = *outputs;
        let word = u16::from_le_bytes([low, high]);
        let state = match word & 0x8F {
            0x06 => 0x0231,
            0x07 => 0x0233,
            0x0F => 0x0237,
            _ => 0x0250,
        };
        let starts = word & !self.before & 0x10 != 0;
        if starts {
            self.position = i32::from_le_bytes([a, b, c, d]);
        }
        let acknowledge = (word & 0x10) << 8;
        let reached = if starts { 0 } else { 0x0400 };
        (self.status, self.before) = (state | acknowledge | reached, word);
        let [low, high] = self.status.to_le_bytes();
        let [a, b, c, d] = self.position.to_le_bytes();
        [low, high, a, b, c, d, 1]
    }
}

/// Runs until this command has ended.
fn run(
    core: &mut AxisCore,
    drive: &mut Drive,
    now: &mut Duration,
    outputs: &mut [u8; OUTPUTS],
    id: CommandId,
) -> Option<Completion> {
    for _ in 0..2000 {
        let inputs = drive.step(outputs);
        *now += CYCLE;
        core.step(*now, Inputs::Fresh(&inputs), outputs);
        while let Some((of, event)) = core.poll_event() {
            if let (true, Event::Done(result)) = (of == id, event) {
                return result.ok();
            }
        }
    }
    None
}

/// What the C runtime calls.
#[unsafe(no_mangle)]
extern "C" fn main() -> i32 {
    let mut fields = AxisFields::at(0, 0);
    (fields.controlword, fields.target, fields.mode) = (0, 2, Some(6));
    (fields.statusword, fields.position, fields.mode_display) = (0, 2, Some(6));
    let mut config = CoreConfig::new(fields);
    config.referencing = Referencing::UnreferencedMovesAllowed;
    config.defaults.velocity = Some(1000);
    let mut core = AxisCore::new(config);
    let mut drive = Drive {
        status: 0x0250,
        position: 0,
        before: 0,
    };
    let (mut now, mut outputs) = (Duration::ZERO, [0; OUTPUTS]);

    core.submit(now, CommandId(1), Command::Enable, &mut outputs);
    if run(&mut core, &mut drive, &mut now, &mut outputs, CommandId(1)) != Some(Completion::Done) {
        return 1;
    }
    let to = Command::Move(MoveCommand {
        reference: Reference::Absolute,
        target: 5000,
        set_point: SetPoint::new(),
        gated: false,
    });
    core.submit(now, CommandId(2), to, &mut outputs);
    match run(&mut core, &mut drive, &mut now, &mut outputs, CommandId(2)) {
        Some(Completion::Reached { position: 5000 }) => 0,
        _ => 2,
    }
}
