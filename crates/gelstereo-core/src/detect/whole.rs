//! Markers found at the image's own size, by every rung of [`Centre`].

use super::fit::{CLEARANCE_PX, ENOUGH_ROWS};
use super::glance::{Eyes, Kind};
use super::row_bits::RowBits;
use super::segments::LEAST_NEIGHBOUR_PX2;
use super::sieve::Sieve;
use super::{DetectError, Detector, Markers, centre, most_markers, rows_between};
use crate::image::GrayView;
use crate::params::Centre;

impl Detector {
    /// Finds the markers; `out` is empty, with room for all of them.
    pub(super) fn run_whole(&mut self, image: GrayView<'_>, out: &mut Markers) -> Result<(), DetectError> {
        self.segments.run(image)?;
        let size_px = (image.width(), image.height());
        let most = most_markers(&self.params, size_px);
        let blobs = self.segments.components.blobs();
        let (sieve, found) = Sieve::of(blobs, &self.params, size_px, &mut self.areas_px2);
        if found > most {
            return Err(DetectError::TooMany { found, most });
        }
        match self.params.centre {
            Centre::Binary => self.take_binary(&sieve, out),
            Centre::Grey => self.take_grey(image, &sieve, None, out),
            Centre::Band => {
                let kind = Kind::of(sieve.usual_px2);
                self.take_grey(image, &sieve, kind, out);
                if let Some(kind) = kind {
                    self.tell_band_noise(image, &kind, out);
                }
            }
            Centre::Matched => {
                self.take_binary(&sieve, out);
                self.match_all(image, &sieve, out);
            }
            Centre::Fit => {
                self.take_binary(&sieve, out);
                self.fit_all(image, &sieve, out);
            }
        }
        let variance = self.typed_variance_px2();
        let blobs = self.segments.components.blobs().iter();
        out.cut.extend(blobs.filter_map(|blob| sieve.cut_marker(blob, variance)));
        Ok(())
    }

    fn take_binary(&self, sieve: &Sieve, out: &mut Markers) {
        let variance = self.typed_variance_px2();
        for blob in self.segments.components.blobs().iter().filter(|blob| sieve.passes_whole(blob)) {
            out.push(centre::binary(blob), [[variance, 0.0], [0.0, variance]], blob.area_px2);
        }
    }

    /// Grey centres, but for markers of a kind that are seen at a glance.
    fn take_grey(&mut self, image: GrayView<'_>, sieve: &Sieve, kind: Option<Kind>, out: &mut Markers) {
        let (variance, eyes) = (self.typed_variance_px2(), kind.map(|kind| Eyes::new(kind, self.flip())));
        let Self { segments, grey_centre, bands, params, .. } = self;
        let components = &segments.components;
        bands.clear();
        for blob in components.blobs().iter().filter(|blob| sieve.passes_whole(blob)) {
            let spot = eyes.as_ref().and_then(|eyes| eyes.centre(image, centre::binary(blob)));
            let (centre_px, band) = match spot {
                Some(spot) => (spot.centre_px, spot.band),
                None => (grey_centre.run(image, blob, components.runs(blob), params.polarity), 0),
            };
            bands.push(band);
            out.push(centre_px, [[variance, 0.0], [0.0, variance]], blob.area_px2);
        }
    }

    fn fit_all(&mut self, image: GrayView<'_>, sieve: &Sieve, out: &mut Markers) {
        let Self { segments, disc_fit: Some(fit), grey_centre, params, .. } = self else { return };
        fit.clear(most_markers(params, (image.width(), image.height())));
        let (components, mask) = segments.draw();
        let whole = || components.blobs().iter().filter(|blob| sieve.passes_whole(blob));
        whole().for_each(|blob| fit.add(centre::binary(blob), blob.spread_px2(components.runs(blob))));
        let others = components.blobs().iter().filter(|blob| blob.area_px2 >= LEAST_NEIGHBOUR_PX2);
        fit.finish(image, mask, others.map(centre::binary), out);
        grey_centre.reserve(image.height());
        let mut unfitted = fit.unfitted().peekable();
        for (k, blob) in whole().enumerate() {
            if unfitted.next_if_eq(&k).is_some() {
                out.centres_px[k] = grey_centre.run(image, blob, components.runs(blob), params.polarity);
            }
        }
    }

    fn match_all(&mut self, image: GrayView<'_>, sieve: &Sieve, out: &mut Markers) {
        let Self { segments, matched, meter, grey_centre, params, .. } = self;
        let components = &segments.components;
        let every = rows_between(image.height(), ENOUGH_ROWS);
        let cover = |rows, near: &mut RowBits| components.cover(rows, 1, near);
        let noise = meter.run_rows(image, &out.centres_px, (every, CLEARANCE_PX), cover);
        matched.prepare(image, noise.unwrap_or_default(), out);
        grey_centre.reserve(image.height());
        let whole = components.blobs().iter().filter(|blob| sieve.passes_whole(blob));
        for (k, blob) in whole.enumerate() {
            if !matched.replace(image, (k, out.area_px2[k]), out) {
                out.centres_px[k] = grey_centre.run(image, blob, components.runs(blob), params.polarity);
            }
        }
    }
}
