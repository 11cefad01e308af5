//! The axis core of another commit beside the present one, for `cargo xtask before twin`.
//!
//! That command makes a tree in which this file is `src/axis/twin.rs`, and this [`AxisCore`] is the one that the bus, the handles and
//! the tests step. Each call goes to both cores, with the same time, inputs and outputs. The present core decides; the other one is
//! compared. Compared are the outputs, what a call returns, each event with all that it carries, and the snapshot.
//!
//! The environment variable `SERVOCRAB_BEFORE` names a file, to which differences and the number of calls are appended. With `panic`
//! the first difference panics in its test. After its first difference a core is compared no more.
#![allow(missing_docs)]

extern crate alloc;
extern crate std;

use core::{
    cell::RefCell,
    fmt::Debug,
    hash::{Hash, Hasher},
    mem,
    ops::Deref,
    time::Duration,
};

use std::{borrow::ToOwned, boxed::Box, env, format, fs::File, io::Write, string::String, thread};

use servocrab_before as before;

#[cfg(feature = "std")]
use super::core::{Reattach, SnapshotChange};
use super::{Command, CommandId, CoreConfig, Event, Inputs, Referencing, Snapshot, StopRequest};
use crate::{
    ds402::{Controlword, Mode},
    homing::HomingCommand,
    profile_position::{
        BufferMode, BufferSignal, HomedSignal, Limits, LimitsActive, LimitsOff, MoveCommand,
        Parameters, PositionRange, Reference, RelativeBase, SetPoint, StartBits, Traits,
    },
    profile_velocity::JogSetPoint,
};

/// Both cores. What only reads goes to the present one.
#[derive(Debug, Clone)]
pub struct AxisCore {
    now: super::core::AxisCore,
    /// None after its first difference.
    before: Option<Box<before::axis::AxisCore>>,
}

impl Deref for AxisCore {
    type Target = super::core::AxisCore;

    fn deref(&self) -> &Self::Target {
        &self.now
    }
}

/// The search of all states knows a core by the present one.
impl Hash for AxisCore {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.now.hash(state);
    }
}

impl AxisCore {
    #[must_use]
    pub fn new(config: CoreConfig) -> Self {
        count(|counts| counts.cores += 1);
        Self {
            before: Some(Box::new(before::axis::AxisCore::new(core_config(&config)))),
            now: super::core::AxisCore::new(config),
        }
    }

    pub fn step(&mut self, now: Duration, inputs: Inputs<'_>, outputs: &mut [u8]) {
        let call = || format!("step at {now:?} with {inputs:02x?}");
        self.both(
            call,
            outputs,
            |core, outputs| core.step(now, inputs, outputs),
            |core, outputs| core.step(now, inputs_of(inputs), outputs),
        );
    }

    pub fn step_kept(
        &mut self,
        now: Duration,
        inputs: Inputs<'_>,
        unchanged: bool,
        outputs: &mut [u8],
    ) -> bool {
        let call = || format!("step_kept at {now:?} with {inputs:02x?}, unchanged: {unchanged}");
        let mut changed = true;
        self.both(
            call,
            outputs,
            |core, outputs| changed = core.step_kept(now, inputs, unchanged, outputs),
            // Which cycles need no work is not behaviour: the outputs are.
            |core, outputs| {
                core.step_kept(now, inputs_of(inputs), unchanged, outputs);
            },
        );
        changed
    }

    pub fn submit(&mut self, now: Duration, id: CommandId, command: Command, outputs: &mut [u8]) {
        self.both(
            || format!("submit at {now:?} of {} {command:?}", id.0),
            outputs,
            |core, outputs| core.submit(now, id, command, outputs),
            |core, outputs| core.submit(now, id_of(id), command_of(command), outputs),
        );
    }

    pub fn apply_stop(&mut self, now: Duration, stop: StopRequest, outputs: &mut [u8]) -> bool {
        let stop_before = before::axis::StopRequest::from_bits_retain(stop.bits());
        self.both(
            || format!("apply_stop at {now:?} of {stop:?}"),
            outputs,
            |core, outputs| core.apply_stop(now, stop, outputs),
            |core, outputs| core.apply_stop(now, stop_before, outputs),
        )
    }

    pub fn withdraw(&mut self, id: CommandId, outputs: &mut [u8]) -> bool {
        self.both(
            || format!("withdraw of {}", id.0),
            outputs,
            |core, outputs| core.withdraw(id, outputs),
            |core, outputs| core.withdraw(id_of(id), outputs),
        )
    }

    pub fn fire(&mut self, now: Duration, id: CommandId, outputs: &mut [u8]) {
        self.both(
            || format!("fire at {now:?} of {}", id.0),
            outputs,
            |core, outputs| core.fire(now, id, outputs),
            |core, outputs| core.fire(now, id_of(id), outputs),
        );
    }

    pub fn set_jog(&mut self, id: CommandId, velocity: i32, outputs: &mut [u8]) -> bool {
        self.both(
            || format!("set_jog of {} to {velocity}", id.0),
            outputs,
            |core, outputs| core.set_jog(id, velocity, outputs),
            |core, outputs| core.set_jog(id_of(id), velocity, outputs),
        )
    }

    pub fn release_jog(&mut self, now: Duration, id: CommandId, outputs: &mut [u8]) -> bool {
        self.both(
            || format!("release_jog at {now:?} of {}", id.0),
            outputs,
            |core, outputs| core.release_jog(now, id, outputs),
            |core, outputs| core.release_jog(now, id_of(id), outputs),
        )
    }

    pub fn hold_jog(
        &mut self,
        now: Duration,
        id: CommandId,
        times: u32,
        outputs: &mut [u8],
    ) -> bool {
        self.both(
            || format!("hold_jog at {now:?} of {}, {times} times", id.0),
            outputs,
            |core, outputs| core.hold_jog(now, id, times, outputs),
            |core, outputs| core.hold_jog(now, id_of(id), times, outputs),
        )
    }

    pub fn note_mode(&mut self, mode: Mode) {
        self.both(
            || format!("note_mode {mode:?}"),
            &mut [],
            |core, _| core.note_mode(mode),
            |core, _| core.note_mode(mode_of(mode)),
        );
    }

    pub fn set_manufacturer_bits(&mut self, bits: Controlword) {
        let bits_before = before::ds402::Controlword::from_bits_retain(bits.bits());
        self.both(
            || format!("set_manufacturer_bits {bits:?}"),
            &mut [],
            |core, _| core.set_manufacturer_bits(bits),
            |core, _| core.set_manufacturer_bits(bits_before),
        );
    }

    pub fn set_expired(&mut self, expired: bool) {
        self.both(
            || format!("set_expired {expired}"),
            &mut [],
            |core, _| core.set_expired(expired),
            |core, _| core.set_expired(expired),
        );
    }

    pub fn canonicalize(&mut self, now: Duration) {
        self.both(
            || format!("canonicalize at {now:?}"),
            &mut [],
            |core, _| core.canonicalize(now),
            |core, _| core.canonicalize(now),
        );
    }

    pub fn poll_event(&mut self) -> Option<(CommandId, Event)> {
        let event = self.now.poll_event();
        let Some(before) = &mut self.before else {
            return event;
        };
        let event_before = before.poll_event();
        if event.is_none() && event_before.is_none() {
            return None;
        }
        count(|counts| counts.events += 1);
        let told = event.as_ref().map(|(id, event)| (id.0, text(event)));
        let told_before = event_before.as_ref().map(|(id, event)| (id.0, text(event)));
        if told != told_before {
            self.differs(&format!(
                "event {}, before {}\nfirst difference of this core: poll_event\n  now    {event:?}\n  before {event_before:?}",
                kind(told.as_ref()),
                kind(told_before.as_ref())
            ));
        }
        event
    }

    /// Does the same to both, and compares what it came to.
    fn both<T: PartialEq + Debug>(
        &mut self,
        call: impl Fn() -> String,
        outputs: &mut [u8],
        of_now: impl FnOnce(&mut super::core::AxisCore, &mut [u8]) -> T,
        of_before: impl FnOnce(&mut before::axis::AxisCore, &mut [u8]) -> T,
    ) -> T {
        let Some(before) = &mut self.before else {
            return of_now(&mut self.now, outputs);
        };
        count(|counts| counts.calls += 1);
        let outputs_were = outputs.to_vec();
        let mut outputs_before = outputs_were.clone();
        let result = of_now(&mut self.now, outputs);
        let result_before = of_before(before, &mut outputs_before);
        let (knows, knows_before) = (self.now.snapshot(), before.snapshot());
        let what = if *outputs != *outputs_before {
            "outputs"
        } else if result != result_before {
            "returned"
        } else if !is_same(&knows, &knows_before) {
            "snapshot"
        } else {
            return result;
        };
        let call = call();
        let name = call.split(' ').next().unwrap_or_default();
        let text = format!(
            "{what} of {name}\nfirst difference of this core: {call}\n  outputs until then {outputs_were:02x?}\n  \
             now    {result:?}, {outputs:02x?}, {knows:?}\n  before {result_before:?}, {outputs_before:02x?}, {knows_before:?}"
        );
        self.differs(&text);
        result
    }

    fn differs(&mut self, text: &str) {
        self.before = None;
        report(text);
    }
}

// What only the bus thread and the handles call.
#[cfg(feature = "std")]
impl AxisCore {
    pub(crate) fn end_homing(&mut self, now: Duration, id: CommandId, outputs: &mut [u8]) -> bool {
        self.both(
            || format!("end_homing at {now:?} of {}", id.0),
            outputs,
            |core, outputs| core.end_homing(now, id, outputs),
            |core, outputs| core.end_homing(now, id_of(id), outputs),
        )
    }

    pub(crate) fn await_op(&mut self, awaits_op: bool) {
        self.both(
            || format!("await_op {awaits_op}"),
            &mut [],
            |core, _| core.await_op(awaits_op),
            |core, _| core.await_op(awaits_op),
        );
    }

    pub(crate) fn restart(&mut self, now: Duration, again: Reattach, outputs: &mut [u8]) {
        let again_before = match &again {
            Reattach::Unknown => before::axis::Reattach::Unknown,
            Reattach::Kept => before::axis::Reattach::Kept,
            Reattach::Anew(config) => before::axis::Reattach::Anew(Box::new(core_config(config))),
        };
        self.both(
            || format!("restart at {now:?}"),
            outputs,
            |core, outputs| core.restart(now, again, outputs),
            |core, outputs| core.restart(now, again_before, outputs),
        );
    }

    pub(crate) fn know(&mut self, config: CoreConfig) {
        let config_before = core_config(&config);
        self.both(
            || "know".to_owned(),
            &mut [],
            |core, _| core.know(config),
            |core, _| core.know(config_before),
        );
    }

    pub(crate) fn forget(&mut self) {
        self.both(
            || "forget".to_owned(),
            &mut [],
            |core, _| core.forget(),
            |core, _| core.forget(),
        );
    }

    pub(crate) fn recall_homing(&mut self) {
        self.both(
            || "recall_homing".into(),
            &mut [],
            |core, _| core.recall_homing(),
            |core, _| core.recall_homing(),
        );
    }

    pub(crate) fn take_change(&mut self) -> SnapshotChange {
        self.now.take_change()
    }

    /// No step is left out, since the other core has to take it as well.
    pub(crate) fn rests_at(&self, _: &Inputs<'_>) -> bool {
        false
    }

    pub(crate) fn count_to(&mut self, cycles: u64) {
        self.now.count_to(cycles);
        if let Some(before) = &mut self.before {
            before.count_to(cycles);
        }
    }
}

/// What an event is called, without what it carries.
fn kind(event: Option<&(u32, String)>) -> String {
    let Some((_, text)) = event else {
        return "none".to_owned();
    };
    let mut depth = 0;
    text.chars()
        .filter(|letter| {
            depth += i32::from(*letter == '{');
            let shown = depth == 0 && !letter.is_whitespace();
            depth -= i32::from(*letter == '}');
            shown
        })
        .collect()
}

fn text(event: &impl Debug) -> String {
    format!("{event:?}")
}

fn is_same(now: &Snapshot, before: &before::axis::Snapshot) -> bool {
    now.cycle == before.cycle
        && now.age == before.age
        && now.answered == before.answered
        && now.lost == before.lost
        && now.statusword.bits() == before.statusword.bits()
        && now.controlword.bits() == before.controlword.bits()
        && now.mode.raw() == before.mode.raw()
        && now.position == before.position
        && now.velocity == before.velocity
        && now.halted == before.halted
        && now.has_set_point == before.has_set_point
        && now.referenced == before.referenced
}

/// What this thread has compared since it wrote that down.
struct Counts {
    thread: String,
    cores: u64,
    calls: u64,
    events: u64,
}

std::thread_local! {
    static COUNTS: RefCell<Counts> = RefCell::new(Counts {
        thread: thread::current().name().unwrap_or("?").to_owned(),
        cores: 0,
        calls: 0,
        events: 0,
    });
}

/// After so many calls it is written down, and when the thread ends: the process may end before that.
const CALLS: u64 = 4096;

impl Drop for Counts {
    fn drop(&mut self) {
        self.write_down();
    }
}

impl Counts {
    fn write_down(&mut self) {
        let [cores, calls, events] =
            [&mut self.cores, &mut self.calls, &mut self.events].map(mem::take);
        append(&format!(
            "compared\t{}\t{}\t{cores}\t{calls}\t{events}\n",
            target(),
            self.thread
        ));
    }
}

fn count(add: impl FnOnce(&mut Counts)) {
    // Cores that are dropped with their thread may be called once more.
    let _ = COUNTS.try_with(|counts| {
        let counts = &mut *counts.borrow_mut();
        add(counts);
        if counts.calls >= CALLS {
            counts.write_down();
        }
    });
}

fn report(text: &str) {
    assert!(
        env::var("SERVOCRAB_BEFORE").as_deref() != Ok("panic"),
        "{text}"
    );
    let thread = thread::current();
    let name = thread.name().unwrap_or("?");
    let text = text.replace('\t', " ").replace('\n', "\\n");
    append(&format!("differs\t{}\t{name}\t{text}\n", target()));
}

/// The test target: its executable's name without the hash.
fn target() -> String {
    let name = env::current_exe().ok().and_then(|path| {
        let name = path.file_stem()?.to_string_lossy().into_owned();
        Some(match name.rsplit_once('-') {
            Some((target, _)) => target.to_owned(),
            None => name,
        })
    });
    name.unwrap_or_default()
}

/// Each line is one write, so that those of several threads do not mix.
fn append(line: &str) {
    let Some(path) = env::var_os("SERVOCRAB_BEFORE").filter(|path| path != "panic") else {
        return;
    };
    let written = File::options()
        .create(true)
        .append(true)
        .open(&path)
        .and_then(|mut file| file.write_all(line.as_bytes()));
    assert!(written.is_ok(), "{} cannot be written", path.display());
}

// The same values in the types of the other commit.

fn id_of(id: CommandId) -> before::axis::CommandId {
    before::axis::CommandId(id.0)
}

fn mode_of(mode: Mode) -> before::ds402::Mode {
    before::ds402::Mode::from_raw(mode.raw())
}

fn inputs_of(inputs: Inputs<'_>) -> before::axis::Inputs<'_> {
    match inputs {
        Inputs::Fresh(bytes) => before::axis::Inputs::Fresh(bytes),
        Inputs::Answered(bytes) => before::axis::Inputs::Answered(bytes),
        Inputs::Stale => before::axis::Inputs::Stale,
    }
}

fn command_of(command: Command) -> before::axis::Command {
    use before::axis::Command as Before;
    match command {
        Command::Enable => Before::Enable,
        Command::Disable => Before::Disable,
        Command::ResetFault => Before::ResetFault,
        Command::SelectMode(mode) => Before::SelectMode(mode_of(mode)),
        Command::PrepareMode(mode) => Before::PrepareMode(mode_of(mode)),
        Command::Home(homing) => Before::Home(homing_of(homing)),
        Command::Jog(jog) => Before::Jog(jog_of(jog)),
        Command::Move(order) => Before::Move(move_of(order)),
        Command::CheckMove(order) => Before::CheckMove(move_of(order)),
        Command::CheckHome => Before::CheckHome,
        Command::CheckJog(velocity) => Before::CheckJog(velocity),
        Command::SetLimits(limits) => Before::SetLimits(limits_of(limits)),
        Command::Halt => Before::Halt,
        Command::Resume => Before::Resume,
        Command::Stop => Before::Stop,
        Command::QuickStop => Before::QuickStop,
        Command::Release => Before::Release,
    }
}

fn homing_of(homing: HomingCommand) -> before::homing::HomingCommand {
    let HomingCommand {
        method,
        offset,
        until,
    } = homing;
    before::homing::HomingCommand {
        method: before::homing::HomingMethod(method.0),
        offset,
        until,
    }
}

fn jog_of(jog: JogSetPoint) -> before::profile_velocity::JogSetPoint {
    let JogSetPoint {
        velocity,
        acceleration,
        deceleration,
        dead_man,
    } = jog;
    before::profile_velocity::JogSetPoint {
        velocity,
        acceleration,
        deceleration,
        dead_man,
    }
}

fn move_of(order: MoveCommand) -> before::profile_position::MoveCommand {
    use before::profile_position as before;
    let MoveCommand {
        reference,
        target,
        set_point,
        gated,
    } = order;
    let SetPoint {
        buffer_mode,
        parameters,
    } = set_point;
    before::MoveCommand {
        reference: match reference {
            Reference::Absolute => before::Reference::Absolute,
            Reference::Relative => before::Reference::Relative,
        },
        target,
        set_point: before::SetPoint {
            buffer_mode: match buffer_mode {
                BufferMode::Aborting => before::BufferMode::Aborting,
                BufferMode::Buffered => before::BufferMode::Buffered,
                BufferMode::Blending => before::BufferMode::Blending,
            },
            parameters: parameters_of(parameters),
        },
        gated,
    }
}

fn parameters_of(parameters: Parameters) -> before::profile_position::Parameters {
    let Parameters {
        velocity,
        acceleration,
        deceleration,
        end_velocity,
        profile_type,
    } = parameters;
    before::profile_position::Parameters {
        velocity,
        acceleration,
        deceleration,
        end_velocity,
        profile_type,
    }
}

fn range_of(range: PositionRange) -> before::profile_position::PositionRange {
    before::profile_position::PositionRange {
        min: range.min,
        max: range.max,
    }
}

fn limits_of(limits: Limits) -> before::profile_position::Limits {
    let Limits {
        software,
        home_offset,
        position_range,
        max_velocity,
    } = limits;
    before::profile_position::Limits {
        software: software.map(range_of),
        home_offset,
        position_range: position_range.map(range_of),
        max_velocity,
    }
}

fn start_bits(bits: StartBits) -> before::profile_position::StartBits {
    use before::profile_position::StartBits as Before;
    match bits {
        StartBits::Bits {
            change_set_immediately,
            change_on_set_point,
        } => Before::Bits {
            change_set_immediately,
            change_on_set_point,
        },
        StartBits::Sequenced => Before::Sequenced,
        StartBits::Unsupported(why) => Before::Unsupported(why),
    }
}

fn homed_signal(homed: HomedSignal) -> before::profile_position::HomedSignal {
    let HomedSignal { object, set, clear } = homed;
    before::profile_position::HomedSignal {
        object: before::coe::ObjectAddress {
            index: object.index,
            subindex: object.subindex,
        },
        set,
        clear,
    }
}

fn traits_of(traits: Traits) -> before::profile_position::Traits {
    use before::profile_position as before;
    let Traits {
        immediately,
        after_current,
        blend,
        start_bits_first,
        buffer_signal,
        relative_base,
        halt_keeps_set_point,
        drive_cycle,
        shows_voltage,
        homed,
        profile_types,
        blend_needs_linear_ramps,
        limits,
        threshold_in_velocity_units,
    } = traits;
    before::Traits {
        immediately: start_bits(immediately),
        after_current: start_bits(after_current),
        blend: start_bits(blend),
        start_bits_first,
        buffer_signal: match buffer_signal {
            BufferSignal::Acknowledge => before::BufferSignal::Acknowledge,
            BufferSignal::None => before::BufferSignal::None,
            BufferSignal::Unknown => before::BufferSignal::Unknown,
        },
        relative_base: match relative_base {
            RelativeBase::PreviousTarget => before::RelativeBase::PreviousTarget,
            RelativeBase::Demand => before::RelativeBase::Demand,
            RelativeBase::Actual => before::RelativeBase::Actual,
            RelativeBase::PositioningOption => before::RelativeBase::PositioningOption,
            RelativeBase::Undocumented => before::RelativeBase::Undocumented,
        },
        halt_keeps_set_point,
        drive_cycle,
        shows_voltage,
        homed: homed.map(homed_signal),
        profile_types,
        blend_needs_linear_ramps,
        limits: before::LimitsRule {
            off: match limits.off {
                LimitsOff::MinNotBelowMax => before::LimitsOff::MinNotBelowMax,
                LimitsOff::BothZero => before::LimitsOff::BothZero,
            },
            less_home_offset: limits.less_home_offset,
            active: match limits.active {
                LimitsActive::Always => before::LimitsActive::Always,
                LimitsActive::WhenReferenced => before::LimitsActive::WhenReferenced,
            },
        },
        threshold_in_velocity_units,
    }
}

fn fields_of(fields: super::AxisFields) -> before::axis::AxisFields {
    let super::AxisFields {
        controlword,
        target,
        mode,
        velocity,
        end_velocity,
        acceleration,
        deceleration,
        profile_type,
        target_velocity,
        statusword,
        position,
        mode_display,
        actual_velocity,
        error_code,
    } = fields;
    before::axis::AxisFields {
        controlword,
        target,
        mode,
        velocity,
        end_velocity,
        acceleration,
        deceleration,
        profile_type,
        target_velocity,
        statusword,
        position,
        mode_display,
        actual_velocity,
        error_code,
    }
}

fn core_config(config: &CoreConfig) -> before::axis::CoreConfig {
    let CoreConfig {
        fields,
        traits,
        mode,
        supported_modes,
        tolerances,
        deadlines,
        loss,
        quick_stop,
        stop_options,
        velocity_windows,
        defaults,
        limits,
        modulo,
        referencing,
        homed,
    } = config.clone();
    before::axis::CoreConfig {
        fields: fields_of(fields),
        traits: traits_of(traits),
        mode: mode_of(mode),
        supported_modes: supported_modes
            .map(|modes| before::ds402::SupportedModes::from_bits_retain(modes.bits())),
        tolerances: before::axis::Tolerances {
            position: tolerances.position,
            velocity: tolerances.velocity,
            settle: tolerances.settle,
        },
        deadlines: before::axis::Deadlines {
            enable: deadlines.enable,
            disable: deadlines.disable,
            acknowledge: deadlines.acknowledge,
            begin: deadlines.begin,
            standstill: deadlines.standstill,
            mode: deadlines.mode,
            fault_reset: deadlines.fault_reset,
        },
        loss: before::axis::Loss {
            stale_cycles: loss.stale_cycles,
            undelivered_cycles: loss.undelivered_cycles,
        },
        quick_stop: before::ds402::QuickStopOption(quick_stop.0),
        stop_options: before::ds402::StopOptions {
            shutdown: stop_options.shutdown,
            disable_operation: stop_options.disable_operation,
            halt: stop_options.halt,
            fault_reaction: stop_options.fault_reaction,
        },
        velocity_windows: before::ds402::VelocityWindows {
            window: velocity_windows.window,
            window_ms: velocity_windows.window_ms,
            threshold: velocity_windows.threshold,
            threshold_ms: velocity_windows.threshold_ms,
        },
        defaults: parameters_of(defaults),
        limits: limits_of(limits),
        modulo: modulo.map(range_of),
        referencing: match referencing {
            Referencing::ByHoming => before::axis::Referencing::ByHoming,
            Referencing::AbsoluteEncoder => before::axis::Referencing::AbsoluteEncoder,
            Referencing::UnreferencedMovesAllowed => {
                before::axis::Referencing::UnreferencedMovesAllowed
            }
        },
        homed,
    }
}
