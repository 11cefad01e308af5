//! What is read of each axis of a drive on its way to SAFEOP, and what it does when the process data stop.

use super::{
    BringUpStep, DriveFault,
    axes::Parameters,
    config::{AxisDeclaration, Turn},
    drive_setup::{Failed, Job},
    log::Note,
    reactor::Context,
};
use crate::{
    axis::{AxisConfig, AxisFields, Tolerances},
    coe::{AbortCode, AxisOffset, DriveError, Number, Object, Readable, SdoError, SdoHandle, obj},
    ds402::{AbortConnection, QuickStopOption, StopOptions, SupportedModes, VelocityWindows},
    profile_position::{self, Limits, RelativeBase},
};

impl Job {
    /// What is read of an axis, and what the program says of it.
    pub(super) async fn axis_config(
        &self,
        sdo: &SdoHandle,
        axis: &AxisDeclaration,
        fields: AxisFields,
        offset: AxisOffset,
    ) -> Result<AxisConfig, Failed> {
        let mut config = AxisConfig::new(fields);
        config.traits = self.config.description.traits;
        config.mode = axis.mode;
        config.deadlines = axis.deadlines;
        config.referencing = axis.referencing;
        config.loss = axis.loss.unwrap_or(self.loss);
        config.tolerances = axis.tolerances.unwrap_or_default();
        if axis.tolerances.is_none()
            && let Some(position) = read_if_there(sdo, obj::POSITION_WINDOW.offset(offset)).await?
            // FFFFFFFFh switches the window off (CiA DSP 402 v2.0, object 6067h).
            && position != u32::MAX
        {
            config.tolerances = Tolerances {
                position,
                ..config.tolerances
            };
        }
        if let Some(code) = read_if_there(sdo, obj::QUICK_STOP_OPTION.offset(offset)).await? {
            config.quick_stop = QuickStopOption(code);
        }
        if !config.quick_stop.stops_under_control() && !axis.coasts {
            let axis = axis.name.clone();
            return Err((
                BringUpStep::Parameters,
                DriveFault::QuickStopCoasts { axis },
            ));
        }
        config.stop_options = StopOptions {
            shutdown: read_if_there(sdo, obj::SHUTDOWN_OPTION.offset(offset)).await?,
            disable_operation: read_if_there(sdo, obj::DISABLE_OPERATION_OPTION.offset(offset))
                .await?,
            halt: read_if_there(sdo, obj::HALT_OPTION.offset(offset)).await?,
            fault_reaction: read_if_there(sdo, obj::FAULT_REACTION_OPTION.offset(offset)).await?,
        };
        config.velocity_windows = VelocityWindows {
            window: read_if_it_can_be(sdo, obj::VELOCITY_WINDOW.offset(offset)).await?,
            window_ms: read_if_it_can_be(sdo, obj::VELOCITY_WINDOW_TIME.offset(offset)).await?,
            threshold: read_if_it_can_be(sdo, obj::VELOCITY_THRESHOLD.offset(offset)).await?,
            threshold_ms: read_if_it_can_be(sdo, obj::VELOCITY_THRESHOLD_TIME.offset(offset))
                .await?,
        };
        if axis.tolerances.is_none()
            && config.traits.threshold_in_velocity_units
            && let Some(threshold) = config.velocity_windows.threshold
        {
            config.tolerances.velocity = threshold.into();
        }
        config.supported_modes = read_if_it_can_be(sdo, obj::SUPPORTED_MODES.offset(offset))
            .await?
            .map(SupportedModes::from_bits_retain);
        if config.traits.relative_base == RelativeBase::PositioningOption
            && let Some(code) = read_if_there(sdo, obj::POSITIONING_OPTION.offset(offset)).await?
        {
            config.traits.relative_base = RelativeBase::of_positioning_option(code);
        }
        config.defaults = profile_position::Parameters {
            velocity: read_if_there(sdo, obj::PROFILE_VELOCITY.offset(offset)).await?,
            acceleration: read_if_there(sdo, obj::PROFILE_ACCELERATION.offset(offset)).await?,
            deceleration: read_if_there(sdo, obj::PROFILE_DECELERATION.offset(offset)).await?,
            end_velocity: match fields.end_velocity {
                Some(_) => read_if_there(sdo, obj::END_VELOCITY.offset(offset)).await?,
                None => None,
            },
            profile_type: match fields.profile_type {
                Some(_) => read_if_there(sdo, obj::MOTION_PROFILE_TYPE.offset(offset)).await?,
                None => None,
            },
        };
        let held = match (axis.limits, axis.modulo) {
            (Some(limits), None | Some(Turn::These(_))) => limits,
            _ => Limits::read(&Parameters(sdo.clone()), offset)
                .await
                .map_err(|error| (BringUpStep::Parameters, error.into()))?,
        };
        config.limits = axis.limits.unwrap_or(held);
        let turn = match axis.modulo {
            None => return Ok(config),
            Some(Turn::OfDrive) => held.position_range,
            Some(Turn::These(turn)) => Some(turn),
        };
        config.modulo = turn.filter(|turn| turn.length().is_some());
        if config.modulo.is_none() {
            let axis = axis.name.clone();
            return Err((BringUpStep::Parameters, DriveFault::NoTurn { axis }));
        }
        Ok(config)
    }
}

/// Sets what the axis does when the process data stop to a value that stops it, and checks what the drive holds then.
pub(super) async fn stop_on_loss(
    context: &Context,
    sdo: &SdoHandle,
    axis: &AxisDeclaration,
    offset: AxisOffset,
    quick_stop: QuickStopOption,
) -> Result<(), Failed> {
    let step = BringUpStep::AbortConnection;
    let object = obj::ABORT_CONNECTION_OPTION.offset(offset);
    let Some(mut value) = read_if_there(sdo, object)
        .await
        .map_err(|(_, error)| (step, error))?
    else {
        let axis = axis.name.clone();
        let note = Note::NoAbortConnection { axis };
        context.log.note(context.time.now(), note);
        return Ok(());
    };
    // A quick stop that only switches off would let the axis coast: then a fault, which has a reaction of its own.
    let preferred = [
        AbortConnection::QuickStop,
        AbortConnection::Malfunction,
        AbortConnection::DisableVoltage,
    ];
    let skip = usize::from(!quick_stop.stops_under_control());
    for choice in preferred.into_iter().skip(skip) {
        if value == choice.raw() {
            return Ok(());
        }
        match sdo.write(object, choice.raw()).await {
            Ok(()) => {}
            Err(error) if error.error.abort_code().is_some() => continue,
            Err(error) => return Err(at(step)(error)),
        }
        value = sdo.read(object).await.map_err(at(step))?;
        if value == choice.raw() {
            return Ok(());
        }
    }
    if AbortConnection::from_raw(value).stops() {
        return Ok(());
    }
    let axis = axis.name.clone();
    Err((step, DriveFault::DoesNotStop { axis, value }))
}

/// Reads an object that a drive need not have.
async fn read_if_there<T: Number, A: Readable>(
    sdo: &SdoHandle,
    object: Object<T, A>,
) -> Result<Option<T>, Failed> {
    match sdo.read(object).await {
        Ok(value) => Ok(Some(value)),
        Err(DriveError {
            error: SdoError::Aborted { code, .. },
            ..
        }) if code == AbortCode::NO_OBJECT || code == AbortCode::NO_SUBINDEX => Ok(None),
        Err(error) => Err(at(BringUpStep::Parameters)(error)),
    }
}

/// Reads an object without which the axis attaches all the same, whatever the drive says of it.
async fn read_if_it_can_be<T: Number, A: Readable>(
    sdo: &SdoHandle,
    object: Object<T, A>,
) -> Result<Option<T>, Failed> {
    match sdo.read(object).await {
        Ok(value) => Ok(Some(value)),
        Err(DriveError {
            error: SdoError::Aborted { .. } | SdoError::WrongSize { .. },
            ..
        }) => Ok(None),
        Err(error) => Err(at(BringUpStep::Parameters)(error)),
    }
}

fn at(step: BringUpStep) -> impl Fn(DriveError) -> Failed {
    move |DriveError { error, .. }| (step, error.into())
}
