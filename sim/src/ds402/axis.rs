//! The axis as the segment around it sees it: objects in and out, one call per drive cycle, and the handles by which a
//! test disturbs it.

use core::time::Duration;
use std::collections::VecDeque;

use super::behaviour::{Behaviour, FactorChange};
use super::buffer::Buffer;
use super::emergency::{self, Emergency};
use super::hanging::HoldingBrake;
use super::homing::HomingState;
use super::ledger::{Executed, Homing, VelocityPhase};
use super::objects::{self, Address, Entry, Objects, SetError};
use super::plant::{Plant, Shaft};
use super::power::Fault;
use super::state::State;
use super::status::Reached;
use super::touch_probe::TouchProbes;
use super::trajectory::Trajectory;
use super::velocity::VelocityState;
use super::wall::Wall;

/// What an acknowledge can do wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum AckFault {
    /// Nothing.
    #[default]
    None,
    /// Bit 12 never rises, although set-points are taken.
    Never,
    /// Bit 12 is always 1.
    StuckHigh,
}

/// Misbehaviour that a test switches on and off while the axis runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Disturbances {
    /// Bit 12 of the statusword.
    pub ack: AckFault,
    /// Cycles from taking a set-point to bit 12.
    pub ack_delay_cycles: u32,
    /// Cycles for which a bit 10 left over from the move before stays after a set-point was taken.
    pub stale_reached_cycles: u32,
    /// Rising edges of bit 4 are not seen.
    pub deaf_to_bit_4: bool,
    /// Bit 8 of the controlword is not seen.
    pub deaf_to_halt: bool,
    /// Quick stop (bit 2 of the controlword low) is not obeyed in Operation enabled.
    pub deaf_to_quick_stop: bool,
    /// 60B8h is not seen.
    pub deaf_to_touch_probe: bool,
    /// Cycles by which 60B9h is shown late.
    pub touch_probe_lag_cycles: u32,
    /// The shaft does not turn: the actual position stays. Released, the shaft follows its demand again.
    pub blocked: bool,
    /// Bit 10 of the statusword is 0 in homing mode until a homing has ended: "in progress" all the time.
    pub progress_before_homing: bool,
    /// Bit 11 of the statusword is always 1, whatever the drive limits.
    pub always_limited: bool,
    /// The holding brake stays as it is, open or closed.
    pub brake_sticks: bool,
}

/// One DS402 axis.
///
/// ```
/// use servocrab_sim::ds402::{Axis, Behaviour, State};
///
/// let mut axis = Axis::new(Behaviour::generic());
/// axis.cycle(core::time::Duration::from_millis(1));
/// axis.cycle(core::time::Duration::from_millis(2));
/// assert_eq!(axis.state(), State::SwitchOnDisabled);
/// assert_eq!(axis.get(0x6041, 0), Some(0x0250));
/// ```
#[derive(Debug, Clone)]
pub struct Axis {
    pub(super) behaviour: Behaviour,
    pub(super) objects: Objects,
    pub(super) disturbances: Disturbances,
    /// Time of the last cycle.
    pub(super) now: Duration,
    pub(super) cycles: u64,

    pub(super) state: State,
    pub(super) cycles_in_state: u32,
    /// The state to which a disabling ramp leads.
    pub(super) leaving_to: Option<State>,
    pub(super) fault: Fault,
    /// The controlword of the last cycle: edges are seen against it in every state.
    pub(super) last_controlword: u16,
    pub(super) mode_wait: u32,
    pub(super) voltage: bool,
    pub(super) remote: bool,
    pub(super) inhibited: bool,
    pub(super) warning: bool,
    pub(super) referenced: bool,
    pub(super) connected: bool,

    pub(super) trajectory: Trajectory,
    pub(super) buffer: Buffer,
    pub(super) reached: Reached,
    pub(super) homing: HomingState,
    pub(super) velocity: VelocityState,
    pub(super) touch_probes: TouchProbes,
    /// What is added to a reported position to get the machine's.
    pub(super) machine_offset: i64,
    /// Digital inputs that a test sets, apart from the machine's switches.
    inputs: u32,
    pub(super) shaft: Shaft,
    pub(super) brake: HoldingBrake,
    /// In the machine's counts.
    pub(super) wall: Option<Wall>,
    /// Thousandths of the rated torque, and the time up to which they are asked.
    pub(super) torque_peak: Option<(i16, Duration)>,
    pub(super) lagging: VecDeque<(f64, f64)>,
    /// Where the shaft was when it moved last, in counts, and when that was.
    pub(super) anchor: i64,
    pub(super) moved_at: Option<Duration>,
    pub(super) stands_since: Option<Duration>,

    pub(super) ledger: Vec<Executed>,
    pub(super) homings: Vec<Homing>,
    pub(super) velocity_phases: Vec<VelocityPhase>,
    pub(super) emergencies: VecDeque<Emergency>,
    /// What is in the EEPROM.
    saved: Vec<(Address, i64)>,
}

impl Axis {
    /// An axis just powered up: at position 0, or where its absolute encoder says.
    pub fn new(behaviour: Behaviour) -> Axis {
        let machine = &behaviour.machine;
        let (referenced, mechanical) = (machine.absolute_encoder, machine.start);
        let position = if referenced { mechanical } else { 0 };
        Axis {
            shaft: Shaft::at(behaviour.plant, position),
            objects: Objects::new(&behaviour),
            behaviour,
            disturbances: Disturbances::default(),
            now: Duration::ZERO,
            cycles: 0,
            state: State::NotReadyToSwitchOn,
            cycles_in_state: 0,
            leaving_to: None,
            fault: Fault::default(),
            last_controlword: 0,
            mode_wait: 0,
            voltage: true,
            remote: true,
            inhibited: false,
            warning: false,
            referenced,
            connected: true,
            trajectory: Trajectory::at(position),
            buffer: Buffer::at(position),
            reached: Reached::default(),
            homing: HomingState::default(),
            velocity: VelocityState::default(),
            touch_probes: TouchProbes::default(),
            machine_offset: mechanical.saturating_sub(position),
            inputs: 0,
            brake: HoldingBrake::default(),
            wall: None,
            torque_peak: None,
            lagging: VecDeque::new(),
            anchor: position,
            moved_at: None,
            stands_since: None,
            ledger: Vec::new(),
            homings: Vec::new(),
            velocity_phases: Vec::new(),
            emergencies: VecDeque::new(),
            saved: Vec::new(),
        }
    }

    /// This axis after its power was off and is on again: it stands where it stopped, knows that only from an absolute
    /// encoder, and remembers nothing else but what was saved.
    #[must_use]
    pub fn restarted(&self) -> Axis {
        let mut behaviour = self.behaviour.clone();
        behaviour.machine.start = self.mechanical_position();
        let mut axis = Axis::new(behaviour);
        if axis.behaviour.machine.absolute_encoder {
            axis.shift_coordinates(self.machine_offset);
            axis.referenced = self.referenced;
        }
        axis.wall = self.wall;
        axis.saved.clone_from(&self.saved);
        for (address, value) in &self.saved {
            axis.objects.put(*address, *value);
        }
        axis
    }

    /// Saves the objects that outlive a power failure ([`Entry::saved`]) with their present values.
    pub fn save(&mut self) {
        self.saved = self.objects.to_save();
    }

    /// Forgets what was saved: at the next power-up the objects have their defaults.
    pub fn forget(&mut self) {
        self.saved.clear();
    }

    /// The entries of the object dictionary of this axis, sorted by index and subindex, as for axis 1.
    pub fn entries(&self) -> &[Entry] {
        self.objects.entries()
    }

    /// The value of an object; none where there is no such entry.
    pub fn get(&self, index: u16, subindex: u8) -> Option<i64> {
        self.objects.get((index, subindex))
    }

    /// Writes an object, by SDO or from a PDO alike. It takes effect in the next cycle.
    ///
    /// # Errors
    ///
    /// [`SetError::Unknown`] where there is no such entry, [`SetError::ReadOnly`], and [`SetError::OutOfRange`] for a
    /// value outside the type or the object's range; the old value stays.
    pub fn set(&mut self, index: u16, subindex: u8, value: i64) -> Result<(), SetError> {
        let converts = self.behaviour.factor_change == FactorChange::Numbers;
        let before = converts.then(|| self.objects.unit_sizes());
        self.objects.set((index, subindex), value)?;
        if let Some(before) = before {
            self.convert_from(before);
        }
        Ok(())
    }

    /// Gives an object its value at power-up, also where it can only be read; a value outside its range leaves its own.
    pub(crate) fn power_up_with(&mut self, entry: &Entry, value: i64) {
        if (entry.min..=entry.max).contains(&value) {
            self.objects.put((entry.index, entry.subindex), value);
        }
    }

    /// Runs one drive cycle: moves the axis on by one period, evaluates the objects that were written since the last
    /// cycle, and updates those that can be read.
    ///
    /// `now` is the time of this cycle since an arbitrary epoch; it stamps the ledger and runs the windows' times.
    pub fn cycle(&mut self, now: Duration) {
        self.now = now;
        let start_stop_speed = self.objects.value(objects::START_STOP_SPEED);
        self.trajectory.set_floor(start_stop_speed as f64);
        self.run_brake();
        if self.cycles > 0 && !self.hang() {
            self.advance();
        }
        self.cycles += 1;
        self.follow_demand();
        self.check_following_error();
        self.check_limit_switches();
        self.run_touch_probes();
        let unseen = if self.disturbances.deaf_to_halt {
            0x0100
        } else {
            0
        };
        let controlword = self.controlword() & !unseen;
        let was_enabled = self.state == State::OperationEnabled;
        self.run_state_machine(controlword);
        let mode_became_active = self.update_mode(controlword);
        let rise = self.bit_4_rises(controlword, mode_became_active);
        let can_take = self.state == State::OperationEnabled
            && was_enabled
            && self.leaving_to.is_none()
            && self.remote;
        self.run_set_points(controlword, can_take, rise);
        self.run_homing(controlword, can_take, rise);
        self.run_velocity(controlword, can_take);
        self.publish(controlword);
        self.last_controlword = controlword;
        self.reset_request();
    }

    /// The next emergency message that waits to be sent.
    pub fn take_emergency(&mut self) -> Option<Emergency> {
        self.emergencies.pop_front()
    }

    /// Every set-point that was latched, in order.
    pub fn ledger(&self) -> &[Executed] {
        &self.ledger
    }

    /// Every homing that was started, in order.
    pub fn homings(&self) -> &[Homing] {
        &self.homings
    }

    /// Every velocity to which profile velocity mode has driven the axis, in order.
    pub fn velocity_phases(&self) -> &[VelocityPhase] {
        &self.velocity_phases
    }

    /// Where the shaft is, in counts from the machine's own zero. Homing shifts [`Axis::position`], never this.
    pub fn mechanical_position(&self) -> i64 {
        self.shaft.counts.saturating_add(self.machine_offset)
    }

    /// Whether the drive knows where the machine's zero is: by homing, or by an absolute encoder.
    pub fn is_referenced(&self) -> bool {
        self.referenced
    }

    /// Where the shaft is, in counts, as of the servo's last cycle. It counts on where 6064h, a 32-bit value, wraps, and
    /// does not dither as 6064h does ([`Axis::encoder`]).
    pub fn position(&self) -> i64 {
        self.shaft.counts
    }

    /// How fast the shaft is, in counts/s; 606Ch is an estimate of it.
    pub fn velocity(&self) -> f64 {
        self.shaft.velocity
    }

    /// The encoder's position in counts, before it is turned and wrapped as 6064h shows it.
    pub fn encoder(&self) -> i64 {
        self.shaft.encoder
    }

    /// Where the trajectory generator is, in counts (6062h), and how fast, in counts/s (606Bh).
    pub fn demand(&self) -> (i64, f64) {
        (self.trajectory.counts(), self.trajectory.velocity())
    }

    /// Whether the axis stands: nothing is planned, and the shaft is not faster than [`Plant::standstill_velocity`].
    pub fn stands(&self) -> bool {
        self.trajectory.stands() && self.shaft.is_slow()
    }

    /// The cycle since which [`Axis::stands`] has held without a break; none while the axis moves.
    pub fn stands_since(&self) -> Option<Duration> {
        self.stands_since
    }

    /// The cycle in which the shaft was last seen beyond what loads make of an axis that stands.
    pub fn moved_at(&self) -> Option<Duration> {
        self.moved_at
    }

    /// How the shaft follows its demand.
    pub fn plant(&self) -> &Plant {
        &self.behaviour.plant
    }

    /// Hangs another plant on the axis, where its shaft is and as fast; it stays over a power failure.
    ///
    /// ```
    /// use servocrab_sim::ds402::{Axis, Behaviour, Plant};
    ///
    /// let mut axis = Axis::new(Behaviour::generic());
    /// axis.set_plant(Plant::seeded(4711));
    /// assert_eq!(axis.plant().seed, 4711);
    /// ```
    pub fn set_plant(&mut self, plant: Plant) {
        self.behaviour.plant = plant;
        self.shaft.change(plant);
    }

    /// The statusword (6041h) of the last cycle.
    pub fn statusword(&self) -> u16 {
        self.objects.value(objects::STATUSWORD) as u16
    }

    /// The controlword (6040h) as it was written last.
    pub fn controlword(&self) -> u16 {
        self.objects.value(objects::CONTROLWORD) as u16
    }

    /// The device state.
    pub fn state(&self) -> State {
        self.state
    }

    /// The error register (1001h).
    pub fn error_register(&self) -> u8 {
        emergency::register_of(self.fault.code)
    }

    /// Whether the shaft moved in a cycle later than `time`, by more than loads make of an axis that stands.
    pub fn moved_since(&self, time: Duration) -> bool {
        self.moved_at.is_some_and(|at| at > time)
    }

    /// The axis' misbehaviour, to be changed at any time.
    pub fn disturbances(&mut self) -> &mut Disturbances {
        &mut self.disturbances
    }

    /// Puts the axis at a position without a motion, as by a hand on the shaft; only without power.
    pub fn place(&mut self, position: i64) {
        if !self.state.is_powered() {
            self.trajectory.place(position);
            self.lagging.clear();
            self.shaft.place(position);
            self.anchor = position;
            self.buffer.previous_target = position;
        }
    }

    /// Switches the DC link (bit 4 of the statusword). Without it the axis cannot be switched on; a powered one faults.
    pub fn set_voltage(&mut self, on: bool) {
        self.voltage = on;
    }

    /// Remote (bit 9 of the statusword). In local control (`false`) the controlword is ignored.
    pub fn set_remote(&mut self, remote: bool) {
        self.remote = remote;
    }

    /// The enable input or safe torque off. Inhibited, the drive refuses to switch on; a powered axis coasts and goes to
    /// Switch on disabled.
    pub fn set_inhibited(&mut self, inhibited: bool) {
        self.inhibited = inhibited;
    }

    /// Warning (bit 7 of the statusword).
    pub fn set_warning(&mut self, warning: bool) {
        self.warning = warning;
    }

    /// Whether the axis is referenced, for drives whose position limits need that.
    pub fn set_referenced(&mut self, referenced: bool) {
        self.referenced = referenced;
    }

    /// Digital inputs (60FDh) that are active besides the machine's switches.
    pub fn set_digital_inputs(&mut self, inputs: u32) {
        self.inputs = inputs;
    }

    /// 60FDh as it is now.
    pub(super) fn switches(&self) -> u32 {
        let machine = &self.behaviour.machine;
        let feedback = machine.brake.and_then(|brake| brake.feedback);
        let is_open = feedback.filter(|_| !self.is_braked());
        let brake = is_open.map_or(0, |bit| 1 << bit);
        self.inputs | brake | machine.switches(self.mechanical_position())
    }

    /// From now on a reported position is the machine's less `machine_offset`. Nothing moves.
    pub(super) fn shift_coordinates(&mut self, machine_offset: i64) {
        let by = self.machine_offset.saturating_sub(machine_offset);
        self.machine_offset = machine_offset;
        self.shaft.shift(by);
        self.anchor = self.anchor.saturating_add(by);
        self.trajectory.shift(by);
        for (position, _) in &mut self.lagging {
            *position += by as f64;
        }
        self.buffer.previous_target = self.trajectory.counts();
    }
}
