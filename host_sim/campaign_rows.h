/* The runs of a campaign as a CSV file, one row each: seed, scene, plant, figures, and what went
 * wrong on the bus. Numbers are written so that they read back to the same bits; what a run does
 * not have is empty. The file is the same however many threads ran it. */
#ifndef HOST_SIM_CAMPAIGN_ROWS_H
#define HOST_SIM_CAMPAIGN_ROWS_H

#include "campaign.h"

/* Writes count rows; the file appears whole or not at all. False with *error filled. */
bool campaign_rows_write(const char *path, const campaign_row_t *rows, long count,
                         scenario_error_t *error);

#endif
