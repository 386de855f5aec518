//! Views of grey images.

use gelstereo_core::image::{GrayView, ImageError};

#[test]
fn the_halves_of_a_side_by_side_frame_are_views_of_it() {
    let frame: Vec<u8> = (0..60).collect();
    let whole = GrayView::new(&frame, 10, 6, 10).unwrap();
    let right = whole.crop(5, 0, 5, 6).unwrap();
    assert_eq!((right.width(), right.height()), (5, 6));
    assert_eq!(right.row(0), &[5, 6, 7, 8, 9]);
    assert_eq!(right.row(5), &[55, 56, 57, 58, 59]);
    assert_eq!(right.range(), (5, 59));
    assert_eq!(right.crop(1, 2, 2, 1).unwrap().row(0), &[26, 27]);
}

#[test]
fn row_30_shapes_that_do_not_fit_are_refused_by_name() {
    let bytes = [0; 20];
    let view = |width, height, stride| GrayView::new(&bytes, width, height, stride).map(|_| ());
    assert_eq!(view(0, 5, 4), Err(ImageError::Empty { width: 0, height: 5 }));
    assert_eq!(view(5, 4, 4), Err(ImageError::StrideTooSmall { width: 5, stride: 4 }));
    assert_eq!(view(5, 5, 5), Err(ImageError::BufferTooShort { needed: 25, found: 20 }));
    assert_eq!(
        view(1, 3, usize::MAX),
        Err(ImageError::BufferTooShort { needed: usize::MAX, found: 20 }),
        "a shape whose size overflows"
    );
    for (width, height) in [(65_536, 1), (1, 65_536), (5, usize::MAX)] {
        assert_eq!(view(width, height, width), Err(ImageError::TooLarge { width, height }));
    }
    // The last row may end before its stride does.
    assert_eq!(view(2, 4, 6), Ok(()));
    let whole = GrayView::new(&bytes, 5, 4, 5).unwrap();
    let outside = |x, y, width, height| whole.crop(x, y, width, height).map(|_| ());
    assert_eq!(outside(4, 0, 1, 4), Ok(()));
    assert_eq!(outside(4, 0, 2, 4), Err(ImageError::Outside { right: 6, bottom: 4, width: 5, height: 4 }));
    assert!(outside(usize::MAX, 0, 2, 4).is_err());
    assert_eq!(outside(0, 0, 0, 4), Err(ImageError::Empty { width: 0, height: 4 }));
}
