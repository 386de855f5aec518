use super::*;
use alloc::vec;
use proptest::prelude::*;

proptest! {
    /// A detection goes to the nearest target, unless the second nearest is about as near. The order of the
    /// targets and further targets make no difference.
    #[test]
    fn the_second_nearest_disputes_a_claim(
        distances_px in prop::collection::vec(0.1..8.0_f64, 1..6),
        ways in prop::array::uniform5(0.0..6.3_f64), disputed_px in 0.1..4.0_f64,
    ) {
        let mut canvas = ExtendedLattice::default();
        let places: Vec<DVec2> =
            (0..9).map(|n| DVec2::new(f64::from(n % 3), f64::from(n / 3)) * 20.0).collect();
        canvas.lay(&places, 3, 3, 0);
        let at = DVec2::new(21.0, 19.0);
        let mut matching = Matching::default();
        matching.load(&[at], 20.0);
        matching.start(1);
        let target = |(k, px): (usize, &f64)| (k as u32, at + DVec2::from_angle(ways[k]) * *px);
        matching.targets = distances_px.iter().enumerate().map(target).collect();
        let found = matching.claim(&mut canvas, &[at], 10.0, disputed_px, WindowDetections::default());
        let mut sorted = distances_px.clone();
        sorted.sort_by(f64::total_cmp);
        let apart_px = sorted.get(1).map_or(f64::INFINITY, |second| second - sorted[0]);
        prop_assume!((apart_px - disputed_px).abs() > 1e-9);
        prop_assert_eq!(found, apart_px > disputed_px, "{:?}", distances_px);
        let nearest = distances_px.iter().position(|&px| px == sorted[0]);
        let expected = if found { vec![nearest.unwrap_or(0)] } else { vec![] };
        let owners: Vec<usize> = (0..9).filter(|&site| canvas.found[site] != NONE).collect();
        prop_assert_eq!(owners, expected);
    }
}
