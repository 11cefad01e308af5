//! The registers of a real AKD's ESC beside those of the simulated one.

use servocrab_sim::personality;

use super::vectors::{bytes, number, rows};
use crate::datagrams::Wire;

#[test]
fn the_simulated_esc_differs_from_a_real_akds_as_listed() {
    let wire = Wire::new(personality::akd2g());
    let mut equal = 0;
    for row in rows(include_str!("../../vectors/akd_registers.txt")) {
        let (real, simulated) = (bytes(row[1]), bytes(row[2]));
        let shown = wire.read(number(row[0]), real.len());
        assert_eq!(shown, simulated, "{}: {}", row[0], row[3]);
        equal += usize::from(real == simulated);
    }
    assert_eq!(equal, 6);
}
