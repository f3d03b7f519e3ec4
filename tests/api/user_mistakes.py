"""Lines that a type checker has to refuse; each says what is wrong with it."""

import msal_cli as msal

msal.denosie([[0, 0, 0]], [[0, 0, 0]])  # error: has no attribute
msal.denoise([[0, 0, 0]], [[0, 0, 0]], max_move=[1])  # error: No overload variant
msal.denoise([[0, 0, 0]], [[0, 0, 0]], max_mov=1)  # error: No overload variant
msal.denoise([[0, 0, 0]], [[0, 0, 0]], "msla")  # error: No overload variant
msal.denoise_file("a.ply", "b.ply", iteration=2)  # error: Unexpected keyword argument "iteration"
points = msal.denoise([[0, 0, 0]], [[0, 0, 0]]).points  # error: has no attribute
msal.denoise_file("a.ply", 1)  # error: incompatible type
volume = msal.denoise_folder("scans", "out").volume  # error: has no attribute
