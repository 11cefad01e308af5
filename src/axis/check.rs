//! Everything for which a motion is refused before anything of it is written.

use crate::{
    ds402::Mode,
    profile_position::{Delivery, Failure, MoveCommand, Reference, Start, StartBits},
};

use super::{AxisCore, Referencing, power::Power};

impl AxisCore {
    /// What the drive's limits say of a velocity.
    pub(super) fn check_jog(&self, velocity: i32) -> Result<(), Failure> {
        let limits = &self.config.limits;
        limits.check_velocity(Some(velocity.unsigned_abs()))
    }

    /// Everything for which a homing is refused.
    pub(super) fn check_homing(&self) -> Result<(), Failure> {
        self.check_mode(Mode::Homing)?;
        if self.homing.is_unknown() {
            Err(Failure::NeedsStop)
        } else if self.homing.is_idle() {
            Ok(())
        } else {
            Err(Failure::Busy)
        }
    }

    /// Everything for which a jog is refused, but for ramps that are zero.
    pub(super) fn check_jogging(&self, velocity: i32) -> Result<(), Failure> {
        self.check_mode(Mode::ProfileVelocity)?;
        self.check_jog(velocity)?;
        if self.jogging.is_held() {
            Err(Failure::Busy)
        } else {
            Ok(())
        }
    }

    /// What every start of a motion needs.
    pub(super) fn check_mode(&self, expected: Mode) -> Result<(), Failure> {
        let shown = self.sample.map_or(Mode::None, |s| s.mode);
        if let Some(fault) = self.fault() {
            return Err(fault);
        }
        if self.stopping.is_active() {
            return Err(Failure::QUICK_STOPPED);
        }
        if !matches!(self.power, Power::Enabled) {
            return Err(Failure::NotEnabled {
                state: self.state(),
            });
        }
        if self.halted {
            return Err(Failure::HALTED);
        }
        if self.mode_change.is_some() || shown != expected || self.mode != expected {
            return Err(Failure::WrongMode {
                expected,
                shown,
                delivery: Delivery::NotSent,
            });
        }
        Ok(())
    }

    /// As `check_move`, for a move whose parameters may have to be written by SDO first.
    pub(super) fn check_unmapped_move(&self, mut command: MoveCommand) -> Result<(), Failure> {
        self.check_limits(&command)?;
        let traits = &self.config.traits;
        let set_point = &mut command.set_point;
        traits.check_profile_type(set_point.start, set_point.parameters.profile_type, None)?;
        set_point.parameters = self.config.fields.mapped(&set_point.parameters);
        self.check_move(command).map(drop)
    }

    /// What the drive's limits say of a move. Where a relative one ends shows when its turn comes.
    fn check_limits(&self, command: &MoveCommand) -> Result<(), Failure> {
        let limits = &self.config.limits;
        let parameters = &command.set_point.parameters;
        limits.check_velocity(parameters.velocity)?;
        limits.check_velocity(parameters.end_velocity)?;
        match command.reference {
            Reference::Absolute => {
                let rule = &self.config.traits.limits;
                limits.check_target(command.target.into(), rule, self.is_referenced())
            }
            Reference::Relative => Ok(()),
        }
    }

    /// Everything that can be refused before anything is written.
    pub(super) fn check_move(&self, mut command: MoveCommand) -> Result<MoveCommand, Failure> {
        let start = command.set_point.start;
        if let StartBits::Unsupported(reason) = self.config.traits.bits(start) {
            return Err(Failure::Unsupported { start, reason });
        }
        self.check_mode(Mode::ProfilePosition)?;
        if self.sequencer.is_unknown() {
            return Err(Failure::NeedsStop);
        }
        if command.reference == Reference::Absolute
            && !self.is_referenced()
            && self.config.referencing != Referencing::UnreferencedMovesAllowed
        {
            return Err(Failure::NotReferenced);
        }
        self.check_limits(&command)?;
        let parameters = &mut command.set_point.parameters;
        *parameters = self
            .config
            .fields
            .complete(parameters, &self.config.defaults)?;
        self.check_profile_type(&command)?;
        Ok(command)
    }

    fn check_profile_type(&self, command: &MoveCommand) -> Result<(), Failure> {
        let traits = &self.config.traits;
        let set_point = &command.set_point;
        let blends = set_point.start == Start::Blend && traits.blend_needs_linear_ramps;
        if blends && self.config.fields.profile_type.is_none() {
            // Written by SDO it would not be known here, nor changed between two set-points.
            return Err(Failure::NotMapped("motion profile type 6086h"));
        }
        traits.check_profile_type(
            set_point.start,
            set_point.parameters.profile_type,
            self.sequencer.last_profile_type(),
        )
    }
}
